"""What a reconstruction is asked to do."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from nw_eval.errors import UsageError

Engine = Literal["sweep", "openmvs"]


@dataclass(frozen=True, kw_only=True)
class DepthOptions:
    """How depth is measured. The defaults are those that were measured; see the report's figures.

    Attributes:
        side: pixels of a picture's longer side while it is compared; larger ones are shrunk.
        planes: that are swept through each picture, evenly in inverse depth.
        neighbours: pictures that each one is compared with.
        best: of those count at each pixel: the others may look at something that hides it.
        window: side of the square that is compared, pixels, odd.
        step: cost of a change by one plane between neighbouring pixels; a match costs 0 to 1.
        jump: cost of a larger change.
        least_likeness: normalised cross correlation below which nothing is known, unless one
            neighbour more than `least_agreeing` sees the same surface.
        least_agreeing: neighbours that must see the same surface.
        tolerance: largest difference of what two pictures say, a share of the depth.
    """

    side: int = 640
    planes: int = 128
    neighbours: int = 5
    best: int = 2
    window: int = 7
    step: float = 0.04
    jump: float = 0.3
    least_likeness: float = 0.3
    least_agreeing: int = 2
    tolerance: float = 0.01

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            UsageError: naming the field, its value and what it must be.
        """
        for name, least, most in (
            ("side", 32, 4096),
            ("planes", 8, 512),
            ("neighbours", 1, 32),
            ("best", 1, 2),
            ("window", 3, 31),
            ("least_agreeing", 1, 32),
        ):
            _check(f"depth's {name}", getattr(self, name), least, most)
        for name in ("step", "jump", "least_likeness", "tolerance"):
            _check(f"depth's {name}", getattr(self, name), 0.0, 1.0)
        if self.window % 2 == 0:
            raise UsageError(f"depth's window is {self.window}", fix="give an odd number")


@dataclass(frozen=True, kw_only=True)
class ReconstructOptions:
    """A reconstruction. With the same capture and options the result has the same bits.

    Attributes:
        engine: `sweep`, which needs nothing else, or `openmvs`, whose programs must be on PATH.
        depth: how depth is measured.
        voxel: edge of a voxel in the capture's unit; None for about two pixels of a typical depth.
        least_part: share of the largest part's area that a part must have to be kept.
        planes: whether what is plain is measured by planes, which end at edges; of `sweep` alone.
        flatten: whether planes are made flat where the evidence agrees.
        faces: that the mesh has at most.
        samples: points of the surface that there may be; each takes about 1 kB.
    """

    engine: Engine = "sweep"
    depth: DepthOptions = field(default_factory=DepthOptions)
    voxel: float | None = None
    least_part: float = 0.05
    planes: bool = True
    flatten: bool = True
    faces: int = 200_000
    samples: int = 2_000_000

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            UsageError: naming the field, its value and what it must be.
        """
        if self.engine not in {"sweep", "openmvs"}:
            raise UsageError(f"the engine is {self.engine!r}", fix="give sweep or openmvs")
        if self.voxel is not None and not self.voxel > 0.0:
            raise UsageError(f"the voxel is {self.voxel}", fix="give more than 0")
        _check("least_part", self.least_part, 0.0, 1.0)
        _check("faces", self.faces, 100, 4_000_000)
        _check("samples", self.samples, 1, 20_000_000)


def _check(name: str, value: float, least: float, most: float) -> None:
    if not least <= value <= most:
        raise UsageError(f"{name} is {value}", fix=f"give {least} to {most}")
