"""From photographs, a video or somebody's cameras to a capture."""

from nw_eval.twin.calibrate.calibrate import calibrate
from nw_eval.twin.calibrate.options import CalibrateOptions
from nw_eval.twin.calibrate.report import CalibrationReport, LeftOut

__all__ = ["CalibrateOptions", "CalibrationReport", "LeftOut", "calibrate"]
