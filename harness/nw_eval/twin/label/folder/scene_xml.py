"""The scene XML of the published template: poses of two meshes, a light or three, and waypoints."""

from __future__ import annotations

from collections.abc import Iterable
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from nw_eval.words import Robot

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


def scene_xml(
    *,
    robot: Robot,
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
