"""A capture to depth maps and a mesh, and a report of what was read and done."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from nw_eval.errors import SceneError, UsageError
from nw_eval.files.cache import atomic_path
from nw_eval.twin.capture import Capture, read_capture
from nw_eval.twin.reconstruct.clean import (
    ROOM,
    FlatPlane,
    Hole,
    PartsKept,
    flatten,
    flatten_small,
    holes,
    large_parts,
    on_planes,
    simplify,
)
from nw_eval.twin.reconstruct.depth import DepthMap, depth_maps, near_of, write_map
from nw_eval.twin.reconstruct.mesh import ColourMesh, write_mesh
from nw_eval.twin.reconstruct.openmvs import coloured, maps_of, openmvs_mesh
from nw_eval.twin.reconstruct.options import Engine, ReconstructOptions
from nw_eval.twin.reconstruct.planar import planar_maps
from nw_eval.twin.reconstruct.planes import SupposedPlane, hypotheses
from nw_eval.twin.reconstruct.surface import surface, voxel_of

_LISTED_HOLES = 50

Say = Callable[[str], None]


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


def reconstruct(
    capture_folder: Path,
    out: Path,
    options: ReconstructOptions,
    say: Say,
    threads: int = 2,
) -> ReconstructReport:
    """Reconstruct what a capture shows.

    Writes `out/depth/<shot>.npz` (depth along the optical axis, 0 where not known, and confidence,
    both (H, W) float32 of the picture's size, and normals (H, W, 3) float16 in the camera's frame),
    `out/mesh.ply` and, last, `out/report.json`. A call
    that was cut short is taken up by the next one with the same capture and options.

    Args:
        capture_folder: of `nw_eval.twin.capture`.
        out: a folder for the results, made if it is not there.
        options: see there.
        say: is told of progress.
        threads: at once; the results have the same bits with any number.

    Raises:
        SceneError: the capture cannot be read, or shows too little to measure any depth; or a
            program of OpenMVS fails.
        UsageError: fewer than one thread.
        PrerequisiteError: a package or a program is missing.
        StoreError: a file cannot be written.
    """
    if threads < 1:
        raise UsageError(f"threads is {threads}", fix="give 1 or more")
    capture = read_capture(capture_folder)
    if options.engine == "openmvs":
        maps, whole, voxel = _by_openmvs(capture, capture_folder, out, options, say, threads)
        supposed: list[SupposedPlane] = []
    else:
        maps, supposed, voxel = _by_patchmatch(capture, capture_folder, out, options, say, threads)
        whole = surface(maps, voxel, options.samples, say)
    for each in maps:
        write_map(capture, each, out)
    say(f"cleans {len(whole.faces)} faces")
    flat, planes = flatten(whole, voxel, supposed) if options.flatten else (whole, [])
    flat, small = flatten_small(flat, planes, supposed, voxel) if options.flatten else (flat, [])
    both = [turned for plane in supposed for turned in (plane, plane.turned())]
    islands = on_planes(flat, [*planes, *both], voxel)
    kept, parts = large_parts(flat, options.least_part, islands, ROOM * voxel**2)
    mesh = simplify(kept, options.faces)
    borders = holes(mesh)
    write_mesh(mesh, out / "mesh.ply")
    known = [each.confidence[each.depth > 0] for each in maps]
    with_depth = {each.view.name for each, some in zip(maps, known, strict=True) if len(some)}
    report = ReconstructReport(
        engine=options.engine,
        shots=len(capture.shots),
        without_depth=tuple(s.name for s in capture.shots if s.name not in with_depth),
        coverage=sum(float((m.depth > 0).mean()) for m in maps) / len(capture.shots),
        confidence=float(np.concatenate(known).mean()),
        voxel=voxel,
        vertices=len(mesh.vertices),
        faces=len(mesh.faces),
        faces_before=len(whole.faces),
        area=0.5 * float(np.linalg.norm(mesh.normals, axis=1).sum()),
        parts=parts,
        planes=(*planes, *small),
        holes=tuple(borders[:_LISTED_HOLES]),
        all_holes=len(borders),
    )
    write_report(report, out / "report.json")
    for line in report.lines():
        say(line)
    return report


def _by_patchmatch(
    capture: Capture, folder: Path, out: Path, options: ReconstructOptions, say: Say, threads: int
) -> tuple[list[DepthMap], list[SupposedPlane], float]:
    """Return the depth maps, the planes that they may show, and the edge of a voxel."""
    maps = depth_maps(capture, folder, out, options.depth, say, threads)
    voxel = options.voxel or voxel_of(maps)
    if not options.planes:
        return maps, [], voxel
    planes = hypotheses(surface(maps, voxel, options.samples, say), maps, voxel)
    say(f"{len(planes)} planes may be there")
    near = near_of(capture, maps, options.depth)
    return planar_maps(maps, near, planes, options.depth, say, threads), planes, voxel


def _by_openmvs(
    capture: Capture, folder: Path, out: Path, options: ReconstructOptions, say: Say, threads: int
) -> tuple[list[DepthMap], ColourMesh, float]:
    mesh = openmvs_mesh(capture, folder, out / "openmvs", say, threads)
    maps = maps_of(mesh, capture, folder, options.depth.side, say)
    if not any((each.depth > 0).any() for each in maps):
        raise SceneError("no shot shows the mesh of OpenMVS", fix="read the logs in its folder")
    edges = mesh.vertices[mesh.faces] - mesh.vertices[np.roll(mesh.faces, 1, axis=1)]
    voxel = options.voxel or float(np.median(np.linalg.norm(edges, axis=-1)))
    return maps, coloured(mesh, maps), voxel
