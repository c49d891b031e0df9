"""A robot's own MJCF: its model, written out anew or as its file has it.

In what is written anew one actuator stands for each joint that is driven, and groups tell what
collides from what is seen.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import deepcopy
from typing import Any
from xml.etree.ElementTree import indent, tostring

import mujoco as _mujoco
import numpy as np

from nw_scenes.robots.compiled import CompiledRobot
from nw_scenes.robots.folder import fill_meshes
from nw_scenes.robots.looks import colour_of
from nw_scenes.robots.spec import COLLISION_GROUP, VISUAL_GROUP
from nw_scenes.robots.standing import collides

# Its classes live in compiled modules without type information.
mujoco: Any = _mujoco

# contype of what is only seen, which nothing has in its conaffinity. It is not 0 because
# `mj_multiRay` of MuJoCo 4.0 passes over a body when the ray misses the box around those of its
# geoms that have any collision bit, and with it over visual geoms that stick out.
_HIDDEN = 1 << 30
_REWRITE = "leave as_written out, and the file is rewritten"


def rewritten(robot: CompiledRobot, names: Sequence[str], *, is_seen_apart: bool) -> str:
    """Write the model with one actuator a joint, and groups by what collides and is seen.

    Args:
        robot: compiled; its `mjspec` is changed.
        names: of the joints that have one.
        is_seen_apart: what is only seen is left out.
    """
    spec, model = robot.mjspec, robot.model
    # What was compiled is written out, body by body: classes of defaults may say less.
    for body in spec.bodies[1:]:
        number = int(model.body(body.name).id)
        body.explicitinertial = True
        body.mass, body.inertia = model.body_mass[number], model.body_inertia[number]
        body.ipos, body.iquat = model.body_ipos[number], model.body_iquat[number]
        body.fullinertia = [math.nan, *(0.0,) * 5]  # What is not a number is not set.
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
    spec.compiler.settotalmass = -1.0
    for part in (*robot.geoms(), *spec.joints, *spec.sites, *spec.meshes):
        part.classname = spec.default
    _group_geoms(robot, is_seen_apart=is_seen_apart)
    for what in ("actuators", "cameras", "materials"):
        for each in list(getattr(spec, what)):
            spec.delete(each)
    for name in names:
        actuator = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        actuator.set_to_position(kp=1.0)
        actuator.forcelimited, actuator.forcerange = True, [-1.0, 1.0]
    for joint in spec.joints:  # The motors' limits are the actuators'.
        joint.actfrclimited = False
    robot.compiled(spec)
    return str(spec.to_xml())


def text_as_written(robot: CompiledRobot, names: Sequence[str]) -> str:
    """Return the model file's own text, where it needs no rewriting."""
    tree, model = deepcopy(robot.folder.model), robot.model
    tops = [child for world in tree.iter("worldbody") for child in world]
    free = {each.tag if each.get("type") != "free" else "freejoint" for top in tops for each in top}
    motors = [(each.tag, each.get("name"), each.get("joint")) for each in tree.iter("position")]
    kinds = [
        COLLISION_GROUP if collides(robot.model, geom) else VISUAL_GROUP
        for geom in range(model.ngeom)
    ]
    for what, is_so in (
        ("the file is no MJCF", tree.tag == "mujoco"),
        ("the world holds other than one body", [top.tag for top in tops] == ["body"]),
        ("its body has no free joint", "freejoint" in free),
        (
            "its actuators are other than one position servo a joint, of its name",
            motors == [("position", name, name) for name in names] and model.nu == len(names),
        ),
        (
            f"groups of geoms are not {COLLISION_GROUP}, and {VISUAL_GROUP} of what is seen",
            model.geom_group.tolist() == kinds,
        ),
    ):
        if not is_so:
            raise robot.fault(("model", "as_written"), f"model.as_written: {what}", _REWRITE)
    fill_meshes(tree, robot.folder)
    indent(tree)  # Comments of the file are gone, and left their lines empty.
    return tostring(tree, encoding="unicode")


def round_wheels(robot: CompiledRobot, joints: Sequence[int]) -> None:
    """Let a cylinder roll in place of each mesh that collides and turns with a wheel.

    A hull has facets, and on scanned ground the box round it would not roll.
    """
    for joint in joints:
        number = int(robot.model.jnt_bodyid[joint])
        for geom in robot.mjspec.body(robot.body_name(number)).geoms:
            own = int(robot.model.geom(geom.name).id)
            is_mesh = robot.model.geom_type[own] == mujoco.mjtGeom.mjGEOM_MESH
            if not (is_mesh and collides(robot.model, own)):
                continue
            mesh = int(robot.model.geom_dataid[own])
            first, count = (
                int(robot.model.mesh_vertadr[mesh]),
                int(robot.model.mesh_vertnum[mesh]),
            )
            R = np.empty(9)
            mujoco.mju_quat2Mat(R, robot.model.geom_quat[own])
            points = robot.model.mesh_vert[first : first + count] @ R.reshape(3, 3).T
            points = points + robot.model.geom_pos[own] - robot.model.jnt_pos[joint]
            axis = robot.model.jnt_axis[joint]
            along = points @ axis
            radius = float(np.linalg.norm(points - np.outer(along, axis), axis=1).max())
            quat = np.empty(4)
            mujoco.mju_quatZ2Vec(quat, axis)
            middle = (float(along.min()) + float(along.max())) / 2.0
            geom.type, geom.meshname = mujoco.mjtGeom.mjGEOM_CYLINDER, ""
            geom.size = [radius, float(np.ptp(along)) / 2.0, 0.0]
            geom.pos, geom.quat = robot.model.jnt_pos[joint] + middle * axis, quat


def _group_geoms(robot: CompiledRobot, *, is_seen_apart: bool) -> None:
    """Tell what collides from what is only seen, or leave that out with its meshes."""
    spec = robot.mjspec
    for geom in robot.geoms():
        number = int(robot.model.geom(geom.name).id)
        geom.rgba, geom.material = list(colour_of(robot.model, number)), ""
        if geom.name in robot.solid:
            geom.group = COLLISION_GROUP
        elif is_seen_apart:
            spec.delete(geom)
        else:
            geom.group, geom.contype, geom.conaffinity = VISUAL_GROUP, _HIDDEN, 0
    used = {geom.meshname for geom in robot.geoms()}
    for mesh in list(spec.meshes):
        if mesh.name not in used:
            spec.delete(mesh)
