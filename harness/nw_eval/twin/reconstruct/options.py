"""What a reconstruction is asked to do."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from nw_eval.errors import UsageError

Engine = Literal["patchmatch", "openmvs"]


@dataclass(frozen=True, kw_only=True)
class DepthOptions:
    """How depth is measured. The defaults are those that were measured.

    Attributes:
        side: pixels of a picture's longer side while it is matched; larger ones are shrunk.
        neighbours: pictures that each one is matched with.
        rounds: in which a picture's planes are compared with those of its neighbours.
        worst: cost up to which a pixel is known: 1 less the normalised cross correlation.
        least_agreeing: neighbours that must see the same surface.
        tolerance: largest distance of a pixel's point from a neighbour's plane, a share of depth.
        beside: pixels by which the point may come back from that plane beside its pixel.
        least_angle: degrees between the two views of a point; less says nothing of its depth.
    """

    side: int = 328
    neighbours: int = 5
    rounds: int = 2
    worst: float = 0.7
    least_agreeing: int = 2
    tolerance: float = 0.005
    beside: float = 2.0
    least_angle: float = 1.0

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            UsageError: naming the field, its value and what it must be.
        """
        for name, least, most in (
            ("side", 32, 4096),
            ("neighbours", 1, 32),
            ("rounds", 1, 8),
            ("worst", 0.2, 2.0),
            ("least_agreeing", 1, 32),
            ("tolerance", 0.0, 1.0),
            ("beside", 0.0, 3.0),
            ("least_angle", 0.0, 45.0),
        ):
            _check(f"depth's {name}", getattr(self, name), least, most)


@dataclass(frozen=True, kw_only=True)
class ReconstructOptions:
    """A reconstruction. With the same capture and options the result has the same bits.

    Attributes:
        engine: `patchmatch`, which needs nothing else; `openmvs`, whose programs must be on PATH.
        depth: how depth is measured.
        voxel: edge of a voxel in the capture's unit; None for about two pixels of a typical depth.
        least_part: share of the largest part's area that a part must have to be kept.
        planes: whether what is plain is measured by planes, which end at edges; not of `openmvs`.
        flatten: whether planes are made flat where the evidence agrees.
        faces: that the mesh has at most.
        samples: points of the surface that there may be; each takes about 1 kB.
    """

    engine: Engine = "patchmatch"
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
        if self.engine not in {"patchmatch", "openmvs"}:
            raise UsageError(f"the engine is {self.engine!r}", fix="give patchmatch or openmvs")
        if self.voxel is not None and not self.voxel > 0.0:
            raise UsageError(f"the voxel is {self.voxel}", fix="give more than 0")
        _check("least_part", self.least_part, 0.0, 1.0)
        _check("faces", self.faces, 100, 4_000_000)
        _check("samples", self.samples, 1, 20_000_000)


def _check(name: str, value: float, least: float, most: float) -> None:
    if not least <= value <= most:
        raise UsageError(f"{name} is {value}", fix=f"give {least} to {most}")
