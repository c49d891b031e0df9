"""What a reconstruction read and did."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from nw_eval.files.cache import atomic_path
from nw_eval.twin.reconstruct.clean.flatten import FlatPlane
from nw_eval.twin.reconstruct.clean.holes import Hole
from nw_eval.twin.reconstruct.clean.parts import PartsKept
from nw_eval.twin.reconstruct.options import Engine


@dataclass(frozen=True, kw_only=True)
class ReconstructReport:
    """Figures of a reconstruction; lengths in the capture's unit, places in its frame.

    Attributes:
        engine: that made the surface.
        shots: of the capture.
        without_depth: names of those of whose depth nothing is known.
        coverage: mean share of a picture whose depth is known.
        confidence: its mean where depth is known.
        voxel: edge of a voxel, or for OpenMVS the typical length of an edge.
        vertices: of mesh.ply.
        faces: of mesh.ply.
        faces_before: as the surface came, before it was cleaned.
        area: of mesh.ply.
        parts: what became of loose parts.
        planes: that were made flat, the largest first.
        holes: borders of the surface, the longest first; the first is usually its rim.
        all_holes: how many borders there are; the shortest are not listed.
    """

    engine: Engine
    shots: int
    without_depth: tuple[str, ...]
    coverage: float
    confidence: float
    voxel: float
    vertices: int
    faces: int
    faces_before: int
    area: float
    parts: PartsKept
    planes: tuple[FlatPlane, ...]
    holes: tuple[Hole, ...]
    all_holes: int

    def lines(self) -> list[str]:
        """Return the report in plain words."""
        flat = sum(plane.area * plane.moved for plane in self.planes)
        parts, voxel = self.parts, f"{self.engine}, voxel {self.voxel:.4g}"
        known = f"depth known for {self.coverage:.0%} of their pixels"
        found = [
            f"{self.shots} shots, {known} at a mean confidence of {self.confidence:.2f}",
            f"{self.faces} faces of {self.faces_before} ({voxel}), area {self.area:.4g}",
            f"{parts.kept} parts kept, {parts.dropped} with {parts.dropped_area:.1%} dropped",
            f"{len(self.planes)} planes made flat, an area of {flat:.4g}",
        ]
        if self.without_depth:
            found.append(f"no depth is known of {', '.join(self.without_depth)}")
        for hole in self.holes[1:6]:
            place = ", ".join(f"{v:.3g}" for v in hole.centre)
            found.append(f"a hole of {hole.across:.3g} across at ({place})")
        return found


def write_report(report: ReconstructReport, path: Path) -> None:
    """Write report.json.

    Raises:
        StoreError: the file cannot be written.
    """
    content = {"nw-reconstruct": 1, **asdict(report), "words": report.lines()}
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
