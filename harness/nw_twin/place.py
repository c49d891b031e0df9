"""Writing a scene folder: collision mesh in metres, splat, course, and a suite that runs it.

Edges of a mesh that hang over are cut off: a rim of centimetres stands on what it is the rim of.
Photographs are taken from above, and none shows what is below a rim. There a mesh closes as it
likes, mostly askew and under the edge: a platform gets a lip, thin and with air below, that a foot
would find to be a plank of its own. A lip as narrow as an edge is uncertain is taken for the edge.

Also here: an alignment at work on points, meshes and cameras. A scene need not move its splat:
`scene.yaml` has a similarity from splat to world, which leaves the file as its trainer wrote it.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import SceneError
from nw_base.files.cache import atomic_path
from nw_base.words import Task
from nw_eval.suite.load import robot_from, write_ready_suite
from nw_scenes.capture_file import write_captures
from nw_scenes.folder import SCENE_FILE, load_folder
from nw_scenes.limits import check_similarity, checked_name
from nw_scenes.mesh import FACE_KINDS, TriangleMesh
from nw_scenes.rays import RayScene
from nw_scenes.saving import (
    COLLISION,
    SPLAT,
    rounded,
    similarity_entry,
    write_collision,
    write_yaml,
)
from nw_splat.camera import Camera
from nw_splat.gaussians import quaternions
from nw_twin.capture import Capture

Values = NDArray[np.float64]


def moved_points(T: Values, points: NDArray[np.floating]) -> Values:
    """Return points (N, 3) mapped by a similarity T (4, 4)."""
    return np.einsum("ij,nj->ni", T[:3, :3], points.astype(np.float64)) + T[:3, 3]


def moved_mesh(
    T: Values, vertices: NDArray[np.floating], faces: NDArray[np.integer]
) -> TriangleMesh:
    """Return a mesh in metres, all its faces ground.

    Args:
        T: (4, 4) from capture to metres.
        vertices: (V, 3) in the capture's frame.
        faces: (F, 3), counter-clockwise from outside, as they stay.
    """
    return TriangleMesh(
        vertices=moved_points(T, vertices),
        faces=np.ascontiguousarray(faces, dtype=np.int32),
        kinds=np.full(len(faces), FACE_KINDS.index("ground"), dtype=np.uint8),
    )


def moved_camera(T: Values, camera: Camera) -> Camera:
    """Return a camera in metres: its pose without scale, its near and far planes in metres.

    Raises:
        SceneError: T is no similarity.
    """
    scale = check_similarity(T, "an alignment")
    pose = T @ camera.T_world_camera
    unit = float(np.linalg.norm(pose[:3, 0]))
    pose[:3, :3] /= unit
    return replace(camera, T_world_camera=pose, near=camera.near * scale, far=camera.far * scale)


def moved_capture(T: Values, capture: Capture) -> Capture:
    """Return a capture in metres; its pictures are the same.

    Raises:
        SceneError: T is no similarity.
    """
    shots = tuple(replace(s, camera=moved_camera(T, s.camera)) for s in capture.shots)
    points = moved_points(T, capture.points)
    return replace(capture, shots=shots, points=points, metric=True, up=(0.0, 0.0, 1.0))


CAPTURES, SUITE = "captures.json", "suite.yaml"

F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]

_DOWN = -0.02
"""Upward part of the normal of a face below which it looks down."""
_THICK = 0.15
"""Of a lip at most, metres: what is higher is a wall that leans, or a bridge."""
_REACH = (0.03, 0.06, 0.09)
"""Metres within which a lip must meet what it is the rim of."""
_LEVEL = 0.03
"""Difference in height of a lip and that, metres."""
_BELOW = 2e-4
"""From a surface on which a ray goes on, metres."""
_WAYS = 8


@dataclass(frozen=True, kw_only=True)
class Route:
    """What the robot is to do in a scene.

    Attributes:
        task: what the course asks of it.
        trail: (N, 3) waypoints on top of what it steps on, in order; world, m.
        spawn: x, y, z of the start, on the ground; world, m.
        yaw: where it looks at the start, rad; 0 = along x.
    """

    task: Task
    trail: NDArray[np.float64]
    spawn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw: float = 0.0


def check_scene_name(name: str) -> None:
    """Check the name of a new scene.

    Raises:
        SceneError: the name is not allowed.
    """
    try:
        checked_name(name)
    except ValueError as error:
        raise SceneError(f"name {name!r}: {error}", fix="give another --name") from None


def write_place(
    out: Path,
    *,
    name: str,
    licence: str,
    mesh: Path,
    splat: Path | None,
    T_world_capture: NDArray[np.float64],
    course: Route,
    capture: Capture | None = None,
    robot: str = "go1",
    to_scale: bool = True,
) -> None:
    """Write a scene folder, and a suite of it beside; scene.yaml appears last.

    Args:
        out: the folder, made if it is not there.
        name: of the scene, as `scene.yaml` wants it.
        licence: of the photographs, which the scene shows.
        mesh: PLY in the capture's frame.
        splat: PLY in the capture's frame; None = the scene has no appearance.
        T_world_capture: (4, 4) similarity to metres, z up.
        course: course, task and start.
        capture: whose cameras say from where the scene was photographed; None if unknown.
        robot: of the suite.
        to_scale: whether T_world_capture leads to metres; else the scene says that it does not.

    Raises:
        SceneError: the name is none, the mesh cannot be read, or the scene cannot be loaded.
        StoreError: it cannot be written.
    """
    check_scene_name(name)
    similarity = similarity_entry(T_world_capture)
    _write_collision(mesh, out / COLLISION, T_world_capture)
    text: dict[str, Any] = {
        "nw-scene": 1,
        "name": name,
        "task": course.task,
        "licence": licence,
        **({} if to_scale else {"units": "unknown"}),
        "collision": COLLISION,
        "trail": [rounded(point) for point in course.trail],
        "spawn": {"position": rounded(course.spawn), "yaw": round(float(course.yaw), 4)},
    }
    if splat is not None:
        with atomic_path(out / SPLAT) as temporary:
            shutil.copyfile(splat, temporary)
        text["splat"] = SPLAT
        text["T_world_splat"] = similarity
    if capture is not None:
        moved = moved_capture(T_world_capture, capture)
        poses = [shot.camera.T_world_camera for shot in moved.shots]
        cameras = [(pose[:3, 3].tolist(), quaternions(pose[:3, :3]).tolist()) for pose in poses]
        write_captures(out / CAPTURES, cameras)
        text["captures"] = CAPTURES
    write_yaml(out / SCENE_FILE, text)
    load_folder(out, needs_scale=False)
    write_ready_suite(out / SUITE, name, ["."], robot=robot_from(out, robot))


def _write_collision(mesh: Path, path: Path, T: NDArray[np.float64]) -> None:
    import trimesh

    try:
        read = trimesh.load_mesh(mesh, process=False)
        vertices = moved_points(T, np.asarray(read.vertices))
        faces = without_lips(vertices, np.asarray(read.faces))
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        raise SceneError(f"{mesh} is not a mesh: {error}", fix="reconstruct again") from None
    write_collision(path, vertices, faces)


def without_lips(vertices: F64, faces: NDArray[np.integer]) -> NDArray[np.integer]:
    """Return the faces without the undersides of lips, so that the space below a lip is solid.

    Args:
        vertices: (V, 3) world, m, z up.
        faces: (F, 3), counter-clockwise from outside.
    """
    kinds = np.full(len(faces), FACE_KINDS.index("ground"), np.uint8)
    mesh = TriangleMesh(vertices=vertices, faces=faces.astype(np.int32), kinds=kinds)
    corners = mesh.triangles
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    up = normal[:, 2] / np.maximum(np.linalg.norm(normal, axis=1), 1e-300)
    rays = RayScene(mesh)
    rows = np.flatnonzero(up < _DOWN)
    middles = corners[rows].mean(axis=1)
    above, face = _cast(rays, middles, 1.0)
    thin = (above < _THICK) & (up[face] > 0.0)
    rows, tops = rows[thin], middles[thin] + above[thin, None] * (0.0, 0.0, 1.0)
    lip = np.zeros(len(rows), dtype=bool)
    for reach in _REACH:
        for turn in 2.0 * np.pi * np.arange(_WAYS) / _WAYS:
            lip |= _solid(rays, up, tops + reach * np.array([np.cos(turn), np.sin(turn), 0.0]))
    kept = np.ones(len(faces), dtype=bool)
    kept[rows[lip]] = False
    return faces[kept]


def _solid(rays: RayScene, up: F64, places: F64) -> Mask:
    """Return at which points (N, 3) ground is about as high, and thicker than a lip.

    Args:
        rays: of the mesh.
        up: (F,) upward part of the normals of its faces.
        places: metres.
    """
    start = places + np.array([0.0, 0.0, _LEVEL])
    depth, face = _cast(rays, start, -1.0)
    there = (depth < 2.0 * _LEVEL) & (up[face] > 0.0)
    top = start - np.minimum(depth, 1.0)[:, None] * (0.0, 0.0, 1.0)
    thick, below = _cast(rays, top, -1.0)
    return there & ((up[below] > 0.0) | (thick >= _THICK))


def _cast(rays: RayScene, places: F64, way: float) -> tuple[F64, NDArray[np.int32]]:
    """Return the distance of the next face straight up or down, and which it is, -1 for none."""
    step = np.array([0.0, 0.0, way])
    distance, face = rays.cast(places + _BELOW * step, np.broadcast_to(step, places.shape))
    return distance + _BELOW, face
