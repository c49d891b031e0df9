"""A capture to depth maps and a mesh."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from nw_eval.errors import SceneError, UsageError
from nw_eval.twin.capture import Capture, read_capture
from nw_eval.twin.reconstruct.clean.complete import complete, on_planes
from nw_eval.twin.reconstruct.clean.flatten import flatten
from nw_eval.twin.reconstruct.clean.holes import holes
from nw_eval.twin.reconstruct.clean.parts import large_parts
from nw_eval.twin.reconstruct.clean.simplify import simplify
from nw_eval.twin.reconstruct.clean.small_planes import ROOM, flatten_small
from nw_eval.twin.reconstruct.depth.maps import DepthMap, depth_maps, near_of, write_map
from nw_eval.twin.reconstruct.mesh_file import ColourMesh, write_mesh
from nw_eval.twin.reconstruct.openmvs import openmvs_mesh
from nw_eval.twin.reconstruct.options import ReconstructOptions
from nw_eval.twin.reconstruct.planes.hypotheses import SupposedPlane, hypotheses
from nw_eval.twin.reconstruct.planes.maps import planar_maps
from nw_eval.twin.reconstruct.report import ReconstructReport, write_report
from nw_eval.twin.reconstruct.surface.extract import extract
from nw_eval.twin.reconstruct.surface.shown import coloured, maps_of
from nw_eval.twin.reconstruct.surface.volume import fuse, voxel_of

_LISTED_HOLES = 50

Say = Callable[[str], None]


def reconstruct(
    capture_folder: Path,
    out: Path,
    options: ReconstructOptions,
    say: Say,
    threads: int = 2,
) -> ReconstructReport:
    """Reconstruct what a capture shows.

    Writes `out/depth/<shot>.npz` (depth along the optical axis, 0 where not known, and confidence,
    both (H, W) float32 of the picture's size), `out/mesh.ply` and, last, `out/report.json`. A call
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
        maps, surface, voxel = _by_openmvs(capture, capture_folder, out, options, say, threads)
        supposed: list[SupposedPlane] = []
    else:
        maps, supposed, voxel = _by_sweep(capture, capture_folder, out, options, say, threads)
        surface = extract(fuse(maps, voxel, options.blocks, say, threads), options.least_weight)
    for each in maps:
        write_map(capture, each, out)
    say(f"cleans {len(surface.faces)} faces")
    flat, planes = flatten(surface, voxel) if options.flatten else (surface, [])
    flat, small = flatten_small(flat, planes, supposed, voxel) if options.flatten else (flat, [])
    both = [turned for plane in supposed for turned in (plane, plane.turned())]
    islands = on_planes(flat, [*planes, *both], voxel)
    kept, parts = large_parts(flat, options.least_part, islands, ROOM * voxel**2)
    whole, filled = complete(kept, planes, maps, voxel, small)
    if filled > 0.0:
        say(f"holes of an area of {filled:.4g} are filled where planes go on through them")
    mesh = simplify(whole, options.faces)
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
        faces_before=len(surface.faces),
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


def _by_sweep(
    capture: Capture, folder: Path, out: Path, options: ReconstructOptions, say: Say, threads: int
) -> tuple[list[DepthMap], list[SupposedPlane], float]:
    """Return the depth maps, the planes that they may show, and the edge of a voxel."""
    maps = depth_maps(capture, folder, out, options.depth, say, threads)
    voxel = options.voxel or voxel_of(maps)
    if not options.planes:
        return maps, [], voxel
    first = extract(fuse(maps, voxel, options.blocks, say, threads), options.least_weight)
    planes = hypotheses(first, maps, voxel)
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
