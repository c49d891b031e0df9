"""What calibrations read: photographs, videos, and folders of programs that know the cameras."""

from nw_eval.twin.calibrate.sources.find import find_source
from nw_eval.twin.calibrate.sources.footage import Footage

__all__ = ["Footage", "find_source"]
