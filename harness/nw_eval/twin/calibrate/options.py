"""What a calibration is asked to do."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from nw_eval.errors import UsageError

LENSES = ("SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "PINHOLE", "SIMPLE_PINHOLE")

MOST_MEGAPIXELS = 178
"""Beyond which Pillow takes a picture for an attack."""
_MOST_SIDE = 10_000
"""So that no picture of a capture has more than the 100 million pixels that can be read."""


@dataclass(frozen=True, kw_only=True)
class CalibrateOptions:
    """Options of a calibration.

    Attributes:
        matching: which photographs are compared: `exhaustive` = all with all, as up to thirty are
            always; `retrieval` = each with those most similar to it; `sequential` = with those, and
            those about it in the order of their names; `auto` = sequential for videos and numbered
            names, else retrieval.
        lens: COLMAP's name of the camera model, where the source knows none. One for each size of
            picture and each focal length in EXIF.
        frames: that are taken of a video, at most.
        per_second: frames that are taken of each second of a video, the sharpest of its stretch;
            None = as many as the picture moves.
        features: of each photograph, at most.
        side: pixels of the longer side, at most: of what features are looked for in, and of the
            capture's pictures.
        megapixels: of a photograph, at most; a larger one is left out.
        share: of the photographs that must be placed for the capture to be written.
        seed: of whatever is random.
        threads: that look for features and compare them; they do not change the result.
    """

    matching: Literal["auto", "sequential", "retrieval", "exhaustive"] = "auto"
    lens: Literal[
        "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "PINHOLE", "SIMPLE_PINHOLE"
    ] = "SIMPLE_RADIAL"
    frames: int = 150
    per_second: float | None = None
    features: int = 8192
    side: int = 1600
    megapixels: int = 100
    share: float = 0.7
    seed: int = 0
    threads: int = 1

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            UsageError: naming the one that cannot be used.
        """
        least = {"frames": 3, "features": 100, "side": 64, "megapixels": 1}
        for name, low in (least | {"seed": 0, "threads": 1}).items():
            if getattr(self, name) < low:
                raise UsageError(
                    f"calibration with {name} = {getattr(self, name)}", fix=f"give {low} or more"
                )
        if self.per_second is not None and not 0 < self.per_second < math.inf:
            raise UsageError(
                f"calibration with {self.per_second} frames a second of video", fix="give 1 or so"
            )
        for name, high in {"side": _MOST_SIDE, "megapixels": MOST_MEGAPIXELS}.items():
            if getattr(self, name) > high:
                raise UsageError(
                    f"calibration with {name} = {getattr(self, name)}", fix=f"give {high} or fewer"
                )
        if not 0 < self.share <= 1:
            raise UsageError(f"calibration with share = {self.share}", fix="give 0 to 1")
        if self.lens not in LENSES:
            raise UsageError(
                f"calibration with lens = {self.lens!r}", fix=f"give one of {', '.join(LENSES)}"
            )
