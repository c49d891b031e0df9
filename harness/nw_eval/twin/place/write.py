"""Writing a scene folder: collision mesh in metres, splat, trail, and a suite that runs it."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from ruamel.yaml import YAML

from nw_eval.errors import SceneError
from nw_eval.files.cache import atomic_path
from nw_eval.scenes.capture_file import write_captures
from nw_eval.scenes.folder import SCENE_FILE, load_folder
from nw_eval.scenes.limits import checked_name
from nw_eval.splat.transform import quaternions
from nw_eval.suite.ready import write_ready_suite
from nw_eval.twin.align.apply import moved_capture, moved_points, similarity_entry
from nw_eval.twin.capture import Capture
from nw_eval.twin.place.entries import rounded, write_collision
from nw_eval.twin.place.lips import without_lips
from nw_eval.words import Robot, Task

COLLISION, SPLAT, CAPTURES, SUITE = "collision.ply", "splat.ply", "captures.json", "suite.yaml"


@dataclass(frozen=True, kw_only=True)
class Route:
    """What the robot is to do in a place.

    Attributes:
        task: what the trail asks of it.
        trail: (N, 3) waypoints on top of what it steps on, in order; world, m.
        spawn: x, y, z of the start, on the ground; world, m.
        yaw: where it looks at the start, rad; 0 = along x.
    """

    task: Task
    trail: NDArray[np.float64]
    spawn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw: float = 0.0


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
    title: str = "",
    robot: Robot = "go1",
) -> None:
    """Write a scene folder, and a suite of it beside; scene.yaml appears last.

    Args:
        out: the folder, made if it is not there.
        name: of the scene, as `scene.yaml` wants it.
        licence: of the photographs, which the place shows.
        mesh: PLY in the capture's frame.
        splat: PLY in the capture's frame; None = the place has no looks.
        T_world_capture: (4, 4) similarity to metres, z up.
        course: trail, task and start.
        capture: whose cameras say from where the place was photographed; None = nobody knows.
        title: one line for people.
        robot: of the suite.

    Raises:
        SceneError: the name is none, the mesh cannot be read, or the place cannot be loaded.
        StoreError: it cannot be written.
    """
    try:
        checked_name(name)
    except ValueError as error:
        raise SceneError(f"name {name!r}: {error}", fix="give another --name") from None
    similarity = similarity_entry(T_world_capture)
    _write_collision(mesh, out / COLLISION, T_world_capture)
    text: dict[str, Any] = {
        "nw-scene": 1,
        "name": name,
        "task": course.task,
        "licence": licence,
        "collision": COLLISION,
        "trail": [rounded(point) for point in course.trail],
        "spawn": {"position": rounded(course.spawn), "yaw": round(float(course.yaw), 4)},
    }
    if title:
        text["title"] = title
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
    load_folder(out)
    write_ready_suite(out / SUITE, name, ["."], robot=robot)


def _write_collision(mesh: Path, path: Path, T: NDArray[np.float64]) -> None:
    import trimesh

    try:
        read = trimesh.load_mesh(mesh, process=False)
        vertices = moved_points(T, np.asarray(read.vertices))
        faces = without_lips(vertices, np.asarray(read.faces))
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        raise SceneError(f"{mesh} is no mesh: {error}", fix="reconstruct again") from None
    write_collision(path, vertices, faces)


def write_yaml(path: Path, text: dict[str, Any]) -> None:
    """Write a mapping as YAML, each point on one line, whole or not at all.

    Raises:
        StoreError: it cannot be written.
    """
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = None
    yaml.sort_base_mapping_type_on_output = False  # pyright: ignore[reportAttributeAccessIssue]
    stream = StringIO()
    yaml.dump(text, stream)
    with atomic_path(path) as temporary:
        temporary.write_text(stream.getvalue(), encoding="utf-8")
