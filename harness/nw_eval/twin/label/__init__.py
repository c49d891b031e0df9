"""Labelling a scene folder: where the place lies, what is kept of it, and the robot's course.

`open_labelling` gives the model, which needs no browser; `nw_eval.twin.label.page` shows it in one.
"""

from nw_eval.twin.label.course.reach import Hint
from nw_eval.twin.label.course_edits import Propose
from nw_eval.twin.label.crop import CropBox
from nw_eval.twin.label.labelling import Labelling, open_labelling
from nw_eval.twin.label.state import LabelState, StartPose

__all__ = [
    "CropBox",
    "Hint",
    "LabelState",
    "Labelling",
    "Propose",
    "StartPose",
    "open_labelling",
]
