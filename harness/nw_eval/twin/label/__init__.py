"""Labelling a scene folder: where the place lies, what is kept of it, and the robot's course.

`open_labelling` gives the model, which needs no browser; `nw_eval.twin.label.page` shows it in one.
"""

from nw_eval.twin.label.hints import Hint
from nw_eval.twin.label.labelling import Labelling, Propose, open_labelling
from nw_eval.twin.label.state import CropBox, LabelState, StartPose

__all__ = [
    "CropBox",
    "Hint",
    "LabelState",
    "Labelling",
    "Propose",
    "StartPose",
    "open_labelling",
]
