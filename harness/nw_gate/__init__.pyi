from nw_gate.episodes import Columns as Columns
from nw_gate.episodes import Episode as Episode
from nw_gate.episodes import Evaluation as Evaluation
from nw_gate.episodes import read_evaluation as read_evaluation
from nw_gate.judgement import Judgement as Judgement
from nw_gate.judgement import Limits as Limits
from nw_gate.judgement import TaskFigures as TaskFigures
from nw_gate.judgement import judge as judge
