"""Laying the floor of a scene level: mesh, splat, course and cameras by one transform."""

from __future__ import annotations

import math
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import SceneError, UsageError
from nw_base.files.cache import new_folder
from nw_eval.suite.load import write_ready_suite
from nw_scenes.folder import folder_files, load_folder
from nw_scenes.mesh import TriangleMesh
from nw_twin.label.files import OpenedScene, open_place, save_label
from nw_twin.place import SUITE, Route, moved_points
from nw_twin.scans.scan import (
    UNITS,
    Unit,
    WrittenScan,
    checked_scan,
    lay_course,
    shifted,
    turn_to_z,
)

Values = NDArray[np.float64]


def level_scene(
    folder: Path,
    *,
    floor: Sequence[tuple[float, ...]] = (),
    flip: bool = False,
    unit: Unit = "m",
    trail: Sequence[tuple[float, ...]] | None = None,
    propose: bool = False,
    out: Path | None = None,
) -> WrittenScan:
    """Lay the floor of a scene level, and scale it; mesh, splat, course and cameras go together.

    scene.yaml and the files that it names are replaced as `twin label` replaces them: the old mesh
    stays beside the new one.

    Args:
        folder: the scene's folder; its collision is a mesh.
        floor: three points x, y, z of the floor, in the scene as it lies now, which become z = 0;
            none = it is level.
        flip: put up what would be down. By itself up is the side of the floor that +z is on now,
            or where the floor stands steeper than 60 degrees, the side that more of the mesh is on.
        unit: of the mesh's, the splat's and the floor's numbers now.
        trail: start, and waypoints x, y or x, y, z, in the scene as it lies afterwards; None =
            those that it has go with the mesh.
        propose: lay the course as for a new scan.
        out: folder of a copy, which must not be there; None = the scene is changed where it lies.

    Raises:
        UsageError: the points span no plane, or nothing is asked for; or `out` is in use.
        SceneError: the scene is of boxes, or cannot be read or loaded.
        StoreError: it cannot be written.
    """
    if not (len(floor) or flip or unit != "m" or trail is not None or propose):
        raise UsageError("nothing to do", fix="give --floor, --flip, --unit, --trail or --propose")
    if trail is not None and propose:
        raise UsageError("--trail and --propose exclude each other", fix="give one of them")
    files = folder_files(folder)
    if out is None:
        place = open_place(folder)
        return checked_scan(_levelled(place, floor, flip, unit, trail, propose))
    with new_folder(out, called=folder) as staged:
        for name, path in files.items():
            (staged / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, staged / name)
        levelled = _levelled(open_place(staged), floor, flip, unit, trail, propose)
        write_ready_suite(staged / SUITE, load_folder(staged).name, ["."])
    return checked_scan(replace(levelled, folder=out))


def _levelled(
    place: OpenedScene,
    floor: Sequence[tuple[float, ...]],
    flip: bool,
    unit: Unit,
    trail: Sequence[tuple[float, ...]] | None,
    propose: bool,
) -> WrittenScan:
    if not place.is_scan:
        raise SceneError(
            f"{place.folder}: {place.collision} holds boxes, which are not moved",
            fix="edit them in that file",
        )
    try:
        before = load_folder(place.folder).digest
    except SceneError:  # Such as of a wrong unit.
        before = None
    scale = UNITS[unit]
    fault = None
    T, lines = _levelling(place.mesh, floor, flip, scale)
    moved = TriangleMesh(
        vertices=moved_points(T, place.mesh.vertices),
        faces=place.mesh.faces,
        kinds=place.mesh.kinds,
    )
    task = place.state.task
    if trail is not None or propose:
        course, words, fault = lay_course(moved, None if propose else trail, task)
        lines += words
    else:
        course, words = _moved_course(place, T, scale)
        lines.append(words)
    save_label(
        place,
        course=course,
        mesh=None if np.array_equal(T, np.eye(4)) else moved,
        T_world_opened=T,
    )
    size = np.ptp(moved.vertices, axis=0)
    lines.append(f"the mesh is {size[0]:.3g} x {size[1]:.3g} x {size[2]:.3g} m (x, y, z)")
    digest = load_folder(place.folder).digest
    return WrittenScan(
        folder=place.folder, digest=digest, before=before, lines=tuple(lines), fault=fault
    )


def _levelling(
    mesh: TriangleMesh, floor: Sequence[tuple[float, ...]], flip: bool, scale: float
) -> tuple[Values, list[str]]:
    """Return the (4, 4) similarity that makes the plane of three points z = 0, and what it does."""
    lines: list[str] = []
    T_scaled = np.diag([scale, scale, scale, 1.0])
    if scale != 1.0:
        lines.append(f"scaled by {scale:g}")
    if not len(floor):
        if not flip:
            return T_scaled, lines
        lines.append("turned over: half a turn about x")
        return np.diag([1.0, -1.0, -1.0, 1.0]) @ T_scaled, lines
    if len(floor) != 3 or any(len(point) != 3 for point in floor):
        raise UsageError(
            f"a floor of {len(floor)} points",
            fix="give three, of x, y and z: --floor 0,0,0 1,0,0 0,1,0",
        )
    points = np.array(floor, dtype=np.float64)
    a, b = points[1] - points[0], points[2] - points[0]
    normal = np.cross(a, b)
    longest = max(np.linalg.norm(side) for side in (a, b, b - a))
    width = float(np.linalg.norm(normal)) / max(float(longest), 1e-300)
    if not width > 0.05 * longest:
        raise UsageError(
            "the three points of the floor lie on one line",
            fix="give points that are apart along two directions, a metre or more",
        )
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    reach = 0.05 * float(np.linalg.norm(high - low))
    for point in points:
        if (point < low - reach).any() or (point > high + reach).any():
            raise UsageError(
                f"the point {point.tolist()} of the floor is outside of the mesh, which reaches "
                f"from {low.round(3).tolist()} to {high.round(3).tolist()}",
                fix="give points on the floor as the scene's mesh has it now",
            )
    up = normal / np.linalg.norm(normal)
    if abs(up[2]) >= 0.5:
        up = up if up[2] > 0 else -up
        why = "the side where +z was"
    else:
        rise = float(((mesh.vertices - points[0]) @ up).mean())
        up = up if rise >= 0.0 else -up
        why = (
            f"the side on which the mesh lies, {abs(rise) * scale:.2f} m off the floor in the mean,"
        )
    if flip:
        up, why = -up, "the other side, as with --flip"
    R = np.eye(4)
    R[:3, :3] = turn_to_z(up)
    level = R @ T_scaled
    height = float(moved_points(level, points)[:, 2].mean())
    level = shifted(np.array([0.0, 0.0, -height])) @ level
    angle = math.degrees(math.acos(min(max(float(up[2]), -1.0), 1.0)))
    lines.append(f"turned by {angle:.2f} degrees; up is {why} of the floor, which is at z = 0")
    return level, lines


def _moved_course(place: OpenedScene, T: Values, scale: float) -> tuple[Route, str]:
    state = place.state.moved(T)
    text = "waypoints, start, splat and cameras moved with the mesh"
    start = state.start or place.state.start
    reach = np.array([*state.waypoints]) - np.array(start.position if start else (0.0, 0.0, 0.0))
    if scale < 1.0 and float(np.abs(reach).max(initial=0.0)) < 0.3:
        # scene.yaml is in metres, whatever its mesh is in.
        state = place.state.moved(T @ np.diag([1 / scale, 1 / scale, 1 / scale, 1.0]))
        text = "the waypoints were in metres already; they are turned and shifted with the mesh"
        start = state.start or place.state.start
    assert start is not None
    return (
        Route(
            task=state.task,
            trail=np.array(state.waypoints),
            spawn=start.position,
            yaw=start.yaw,
        ),
        text,
    )
