from typing import TypeAlias

from nw_gate.episodes import Columns as Columns
from nw_gate.episodes import Episode as Episode
from nw_gate.episodes import Evaluation as Evaluation
from nw_gate.episodes import read_evaluation as read_evaluation
from nw_gate.judgement import Judgement as Judgement
from nw_gate.judgement import JudgeSettings as JudgeSettings
from nw_gate.judgement import TaskFigures as TaskFigures
from nw_gate.judgement import judge as judge
from nw_gate.limits.against import LimitGate as LimitGate
from nw_gate.limits.against import LimitMargins as LimitMargins
from nw_gate.limits.against import LimitVerdict as LimitVerdict
from nw_gate.limits.find import LimitSearch as LimitSearch
from nw_gate.limits.find import find_limit as find_limit
from nw_gate.limits.ladder import Ladder as Ladder
from nw_gate.limits.ladder import LimitTrial as LimitTrial
from nw_gate.limits.limit import Limit as Limit

# Earlier names, which are understood for one release.
Limits: TypeAlias = JudgeSettings
