"""A labelled scene the way Neverwhere publishes scenes: an XML for each robot, meshes and splat.

Published robots start at the origin and look along x, so the whole scene is written in the frame of
its start; the task is read from the scene's name, so the name begins with it where it has to. The
XML is of the published template: poses of two meshes, a light or three, and waypoints.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import StoreError
from nw_base.files.inside import what_is
from nw_base.words import ROBOTS
from nw_scenes.limits import check_similarity
from nw_scenes.mesh import TriangleMesh
from nw_scenes.neverwhere.files import row_of
from nw_splat.files import read_splat, write_splat
from nw_twin.label.state import mapped, shift, turn
from nw_twin.place import Route

_NAME_OF_TASK = {"hurdles": "hurdle", "ramps": "ramp"}

# The robots' files, and the cones', are in the code repository, not in scene folders. Their angles
# are radians too; saying so here keeps the file readable without them.
_TEMPLATE = """\
<mujoco model="{robot} scene">
  <compiler angle="radian"/>
  <include file="{robot}/gabe_{robot}.xml"/>
  <option timestep="0.005"/>
  <option sdf_iterations="20" sdf_initpoints="40"/>
  <statistic center="0 0 0.1" extent="1"/>
  <visual>
    <headlight diffuse="0.6 0.6 0.6" ambient="0.3 0.3 0.3" specular="0 0 0"/>
    <global azimuth="-130" elevation="-20"/>
  </visual>
  <extension>
    <plugin plugin="mujoco.sdf.sdflib">
      <instance name="sdf"><config key="aabb" value="0"/></instance>
    </plugin>
  </extension>
  <default>
    <default class="traffic_cone">
      <geom type="mesh" group="2" contype="0" conaffinity="0" euler="1.57 0 0"/>
    </default>
  </default>
  <asset>
    <mesh name="visual_mesh" file={visual} scale="{scale}"/>
    <mesh name="collision_mesh" file={collision}><plugin instance="sdf"/></mesh>
    <material name="collision_mesh_material" rgba="1 1 1 0"/>
    <material name="visual_mesh_material" rgba="0.2 0.2 0.2 1" reflectance="0.5"/>
    <material name="M_TraficCone_Main" rgba="0.8005128 0.10520147 0.014912283 1"/>
    <material name="M_TraficCone_Additional" rgba="0.54038215 0.54038215 0.54038215 1"/>
    <mesh name="cone_0" file="assets/cone/SM_TrafficCone_V0_4/SM_TrafficCone_V0_4_0.obj"
          scale="0.005 0.005 0.005"/>
    <mesh name="cone_1" file="assets/cone/SM_TrafficCone_V0_4/SM_TrafficCone_V0_4_1.obj"
          scale="0.005 0.005 0.005"/>
  </asset>
  <worldbody>
    <light directional="true" pos="0 0 1.5" dir="0 0 -1"/>
    <light name="light_2" directional="true" castshadow="false" ambient="0.1 0.1 0.1"
           diffuse="0.8 0.8 0.8" pos="0.4 0.6 3" dir="-0.1 -0.5 -0.5"/>
    <light name="light_3" directional="true" castshadow="false" ambient="0.01 0.01 0.01"
           diffuse="0.8 0.8 0.8" pos="-4 0.25 0.15" dir="0.2 0 -0.05"/>
    <body name="scene-group-2">
      <body name="collision_mesh" pos="0 0 0" euler="0 0 0">
        <geom name="collision_mesh_geom" type="sdf" mesh="collision_mesh" friction="1.25 0.3 0.3"
              material="collision_mesh_material"><plugin instance="sdf"/></geom>
      </body>
      <body name="mesh" pos="{position}" euler="{euler}">
        <geom name="mesh_geom" type="mesh" mesh="visual_mesh" group="2" contype="0" conaffinity="0"
              material="visual_mesh_material"/>
      </body>
    </body>
{waypoints}
  </worldbody>
</mujoco>
"""

_WAYPOINT = """\
    <body name="waypoint-{label}" mocap="true" pos="{position}">
      <geom name="cone-{label}_1" class="traffic_cone" mesh="cone_0"
            material="M_TraficCone_Additional"/>
      <geom name="cone-{label}_2" class="traffic_cone" mesh="cone_1"
            material="M_TraficCone_Main"/>
    </body>"""


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
        course: task, course and start; world, m.
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
    return (
        scene
        if row.task == course.task
        else f"{_NAME_OF_TASK.get(course.task, course.task)}_{scene}"
    )


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
    files = {path.relative_to(target).as_posix() for path in target.rglob("*")}
    if kind == "file" or target.is_symlink() or files - ours:
        other = ", ".join(sorted(files - ours)[:3]) or "it"
        raise StoreError(
            f"{target} is in the way: {other} was not written here", fix="move it away"
        )


def _write_obj(path: Path, vertices: NDArray[np.float64], mesh: TriangleMesh) -> None:
    with path.open("w", encoding="ascii") as file:
        file.writelines(f"v {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in vertices.tolist())
        file.writelines(f"f {a} {b} {c}\n" for a, b, c in (mesh.faces + 1).tolist())


def scene_xml(
    *,
    robot: str,
    scene: str,
    scale: float,
    position: Iterable[float],
    euler: Iterable[float],
    trail: NDArray[np.float64],
) -> str:
    """Return the scene's XML for a robot.

    Args:
        robot: whose file it includes; the rest is the same for each.
        scene: name of the scene's folder.
        scale: metres in one unit of the visual mesh.
        position: of the visual mesh, m.
        euler: of the visual mesh, rad, intrinsic x y z.
        trail: (K, 3) waypoints, m, as seen from the start.
    """
    # Waypoints are taken in the order of their names as text: all have the same number of digits.
    digits = len(str(len(trail) - 1))
    geometry = f"real_scenes/{scene}/geometry"
    return _TEMPLATE.format(
        robot=robot,
        visual=quoteattr(f"{geometry}/visual_mesh_simplified.obj"),
        collision=quoteattr(f"{geometry}/collision_mesh.obj"),
        scale=_numbers([scale] * 3),
        position=_numbers(position),
        euler=_numbers(euler),
        waypoints="\n".join(
            _WAYPOINT.format(label=str(i).zfill(digits), position=_numbers(point))
            for i, point in enumerate(trail.tolist())
        ),
    )


def _numbers(values: Iterable[float]) -> str:
    return " ".join(f"{float(value):.9g}" for value in values)
