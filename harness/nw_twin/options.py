"""Options of a calibration and of a reconstruction."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from nw_base.errors import UsageError

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
        """Check the numbers; UsageError says what cannot be."""
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


Engine = Literal["patchmatch", "openmvs"]


@dataclass(frozen=True, kw_only=True)
class DepthOptions:
    """How depth is measured. The defaults are those that were measured.

    Attributes:
        side: pixels of a picture's longer side while it is matched; larger ones are shrunk.
        neighbours: pictures that each one is matched with.
        rounds: in which a picture's planes are compared with those of its neighbours.
    """

    side: int = 328
    neighbours: int = 5
    rounds: int = 2

    def __post_init__(self) -> None:
        """Check the numbers; UsageError says what cannot be."""
        for name, least, most in (("side", 32, 4096), ("neighbours", 1, 32), ("rounds", 1, 8)):
            _check(f"depth's {name}", getattr(self, name), least, most)


@dataclass(frozen=True, kw_only=True)
class ReconstructOptions:
    """A reconstruction. With the same capture and options the result has the same bits.

    Attributes:
        engine: `patchmatch`, which needs nothing else; `openmvs`, whose programs must be on PATH.
        depth: how depth is measured.
        voxel: edge of a voxel in the capture's unit; None for about two pixels of a typical depth.
        least_part: share of the largest part's area that a part must have to be kept.
        faces: that the mesh has at most.
    """

    engine: Engine = "patchmatch"
    depth: DepthOptions = field(default_factory=DepthOptions)
    voxel: float | None = None
    least_part: float = 0.05
    faces: int = 200_000

    def __post_init__(self) -> None:
        """Check the numbers; UsageError says what cannot be."""
        if self.engine not in {"patchmatch", "openmvs"}:
            raise UsageError(f"the engine is {self.engine!r}", fix="give patchmatch or openmvs")
        if self.voxel is not None and not self.voxel > 0.0:
            raise UsageError(f"the voxel is {self.voxel}", fix="give more than 0")
        _check("least_part", self.least_part, 0.0, 1.0)
        _check("faces", self.faces, 100, 4_000_000)


def _check(name: str, value: float, least: float, most: float) -> None:
    if not least <= value <= most:
        raise UsageError(f"{name} is {value}", fix=f"give {least} to {most}")
