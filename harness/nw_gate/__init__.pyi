from nw_gate.episodes import Columns, Episode, Evaluation, read_evaluation
from nw_gate.judgement import Judgement, Limits, TaskFigures, judge

__all__ = [
    "Columns",
    "Episode",
    "Evaluation",
    "Judgement",
    "Limits",
    "TaskFigures",
    "judge",
    "read_evaluation",
]
