"""A labelled scene the way Neverwhere publishes scenes: an XML for each robot, meshes and splat.

Published robots start at the origin and look along x, so the whole scene is written in the frame of
its start; the task is read from the scene's name, so the name begins with it where it has to.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import StoreError
from nw_eval.files.inside import what_is
from nw_eval.scenes.mesh import TriangleMesh
from nw_eval.scenes.neverwhere.scan import check_similarity
from nw_eval.scenes.neverwhere.table import row_of
from nw_eval.splat.files import read_splat, write_splat
from nw_eval.twin.label.folder.scene_xml import scene_xml
from nw_eval.twin.label.placement import mapped, shift, turn
from nw_eval.twin.place.write import Route
from nw_eval.words import ROBOTS

_NAME_OF_TASK = {"hurdles": "hurdle", "gaps": "gaps", "ramps": "ramp", "stairs": "stairs"}


def publish_pair(
    folder: Path,
    *,
    name: str,
    course: Route,
    mesh: TriangleMesh,
    splat: Path | None,
    T_world_splat: NDArray[np.float64],
) -> Path:
    """Write a scene folder that Neverwhere's evaluation, and `neverwhere:` references, read.

    Args:
        folder: in which the scene's own folder appears, whole or not at all.
        name: of the scene; its last word names the folder.
        course: task, trail and start; world, m.
        mesh: what can be touched; world, m.
        splat: its file; None = no looks.
        T_world_splat: (4, 4) similarity.

    Returns:
        The scene's folder.

    Raises:
        SceneError: the splat cannot be read.
        StoreError: it cannot be written, or a folder of other things is in its place.
    """
    scene = published_name(name, course)
    target = folder / scene
    _check_replaceable(target, scene)
    T_start_world = turn("z", -course.yaw, (0.0, 0.0, 0.0)) @ shift(
        (-course.spawn[0], -course.spawn[1], -course.spawn[2])
    )
    T_start_splat = T_start_world @ (T_world_splat if splat is not None else np.eye(4))
    collision = mapped(mesh.vertices, T_start_world)
    scale = check_similarity(T_start_splat, "the splat")
    rotation = T_start_splat[:3, :3] / scale
    visual = (collision - T_start_splat[:3, 3]) @ rotation / scale
    euler = euler_angles(rotation)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(dir=folder, prefix=".publish-") as temporary:
            staged = Path(temporary) / scene
            (staged / "geometry").mkdir(parents=True)
            _write_obj(staged / "geometry" / "visual_mesh_simplified.obj", visual, mesh)
            _write_obj(staged / "geometry" / "collision_mesh.obj", collision, mesh)
            placed = {
                "mesh_scale": scale,
                "mesh_pos": T_start_splat[:3, 3].tolist(),
                "mesh_euler": list(euler),
            }
            (staged / "geometry" / "collision_tf.json").write_text(
                json.dumps(placed, indent=2) + "\n", encoding="utf-8"
            )
            for robot in ROBOTS:
                text = scene_xml(
                    robot=robot,
                    scene=scene,
                    scale=scale,
                    position=T_start_splat[:3, 3].tolist(),
                    euler=euler,
                    trail=mapped(course.trail, T_start_world),
                )
                (staged / f"nw-{robot}-{scene}.xml").write_text(text, encoding="utf-8")
            if splat is not None:
                (staged / "3dgs").mkdir()
                write_splat(staged / "3dgs" / "model.pt", read_splat(splat))
            if what_is(target) == "folder":
                target.replace(Path(temporary) / "before")
            staged.replace(target)
    except OSError as error:
        raise StoreError(
            f"cannot write {target}: {error.strerror or error}",
            fix="free disk space, or choose another folder",
        ) from error
    return target


def published_name(name: str, course: Route) -> str:
    """Return the name of the scene's folder, from which its task can be read."""
    scene = name.rsplit("/", 1)[-1]
    row, _ = row_of(scene)
    return scene if row.task == course.task else f"{_NAME_OF_TASK[course.task]}_{scene}"


def euler_angles(rotation: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return a, b, c, rad, with Rx(a) Ry(b) Rz(c) = rotation (3, 3): MuJoCo's default sequence."""
    sine = float(np.clip(rotation[0, 2], -1.0, 1.0))
    if abs(sine) > 1 - 1e-12:  # x and z turn about one line; all of it goes to x.
        return math.atan2(rotation[2, 1], rotation[1, 1]), math.copysign(math.pi / 2, sine), 0.0
    return (
        math.atan2(-rotation[1, 2], rotation[2, 2]),
        math.asin(sine),
        math.atan2(-rotation[0, 1], rotation[0, 0]),
    )


def _check_replaceable(target: Path, scene: str) -> None:
    """Check that nothing but an earlier writing of the same scene would be replaced."""
    ours = {f"nw-{robot}-{scene}.xml" for robot in ROBOTS} | {
        "geometry",
        "geometry/visual_mesh_simplified.obj",
        "geometry/collision_mesh.obj",
        "geometry/collision_tf.json",
        "3dgs",
        "3dgs/model.pt",
    }
    kind = what_is(target)
    found = {path.relative_to(target).as_posix() for path in target.rglob("*")}
    if kind == "file" or target.is_symlink() or found - ours:
        other = ", ".join(sorted(found - ours)[:3]) or "it"
        raise StoreError(
            f"{target} is in the way: {other} was not written here", fix="move it away"
        )


def _write_obj(path: Path, vertices: NDArray[np.float64], mesh: TriangleMesh) -> None:
    with path.open("w", encoding="ascii") as file:
        file.writelines(f"v {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in vertices.tolist())
        file.writelines(f"f {a} {b} {c}\n" for a, b, c in (mesh.faces + 1).tolist())
