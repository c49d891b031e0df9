"""From a robot's figures to its MJCF and its specification.

The figures are the tables that a robot is built from: one row a body, one shape a contact surface.
The MJCF holds the robot alone: bodies, joints, servos and cameras. Ground, obstacles, solver
options and what a protocol changes are added when a world is compiled.
"""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from nw_eval.robots.spec import COLLISION_GROUP, VISUAL_GROUP, RobotSpec, Shape

if TYPE_CHECKING:
    from collections.abc import Iterable

    from nw_eval.robots.spec import CameraMount, Quaternion, Vector3

LEGS = ("FR", "FL", "RR", "RL")
JOINT_KINDS = ("hip", "thigh", "calf")
TRUNK, ROOT_JOINT = "trunk", "root"


@dataclass(frozen=True, kw_only=True)
class Inertial:
    """Mass in kg, centre of mass in the body frame in m, principal inertia in kg m^2."""

    mass: float
    com: Vector3
    principal: Vector3
    quat: Quaternion  # of the principal frame in the body frame


@dataclass(frozen=True, kw_only=True)
class Link:
    """One moving body of a leg and the joint that carries it."""

    position: Vector3  # of the joint, in the parent body
    axis: Vector3
    range: tuple[float, float]  # rad
    inertial: Inertial


@dataclass(frozen=True, kw_only=True)
class Leg:
    """Hip, thigh and calf of one leg; bodies and joints are named after it."""

    name: str
    hip: Link
    thigh: Link
    calf: Link


@dataclass(frozen=True, kw_only=True)
class Attachment:
    """A body welded to the trunk, whose mass comes from its collision shapes."""

    name: str
    position: Vector3


@dataclass(frozen=True, kw_only=True)
class FollowingCamera:
    """A camera that keeps its offset from the centre of mass and does not turn with the trunk.

    Axes are MuJoCo's: x right, y up, looking along minus z.
    """

    name: str
    position: Vector3
    x_axis: Vector3
    y_axis: Vector3
    fovy: float  # rad


@dataclass(frozen=True, kw_only=True)
class Figures:
    """Everything that a robot and its MJCF are made from."""

    name: str
    trunk: Inertial
    attachments: tuple[Attachment, ...]
    legs: tuple[Leg, ...]  # in the order of `LEGS`
    collisions: tuple[Shape, ...]
    visuals: tuple[Shape, ...]
    cameras: dict[str, CameraMount]
    followers: tuple[FollowingCamera, ...]
    spawn_height: float
    kp: float
    joint_damping: float
    armature: float
    friction_loss: float
    torque_limit: float
    geom_friction: Vector3
    contact_margin: float  # m, of a pair of geoms
    default_pose: tuple[float, ...]  # rad, in the order of the joints
    monitored: tuple[str, ...]  # geoms
    published_monitored: tuple[str, ...]
    fell_tilt: float
    collided_force: float
    height_camera_offset: Vector3  # m, of the published height map's camera


def make_spec(figures: Figures) -> RobotSpec:
    """Return the robot of those figures, its MJCF written."""
    links = [link for leg in figures.legs for link in (leg.hip, leg.thigh, leg.calf)]
    count = len(links)
    damping, armature, friction = figures.joint_damping, figures.armature, figures.friction_loss
    return RobotSpec(
        name=figures.name,
        joints=tuple(f"{leg}_{kind}_joint" for leg in LEGS for kind in JOINT_KINDS),
        default_pose=figures.default_pose,
        joint_ranges=tuple(link.range for link in links),
        kp=(figures.kp,) * count,
        joint_damping=(damping,) * count,
        torque_limits=(figures.torque_limit,) * count,
        armature=(armature,) * count,
        friction_loss=(friction,) * count,
        root_joint=ROOT_JOINT,
        touches="geom",
        feet=LEGS,
        monitored=figures.monitored,
        published_monitored=figures.published_monitored,
        fell_tilt=figures.fell_tilt,
        collided_force=figures.collided_force,
        root_defaults=(damping, armature, friction),
        cameras=figures.cameras,
        height_camera_offset=figures.height_camera_offset,
        bodies=body_names(figures),
        visuals=figures.visuals,
        spawn_height=figures.spawn_height,
        mjcf=write_mjcf(figures),
    )


# What is seen collides with nothing, since nothing has this bit in its conaffinity. It is not 0
# because `mj_multiRay` of MuJoCo 4.0 passes over a body when the ray misses the box around those
# of its geoms that have any collision bit, and with it over visual geoms that stick out.
_VISUAL_CONTYPE = 2


# Density of a welded body without figures of its own, kg / m^3 (MuJoCo's default, as published).
_DENSITY = 1000.0


def write_mjcf(figures: Figures) -> str:
    """Return the robot of those figures as MJCF text.

    The root joint is a free joint that takes none of the joint defaults; see `sim.model` for the
    protocol under which it does.
    """
    root = Element("mujoco", model=figures.name)
    SubElement(root, "compiler", angle="radian", autolimits="true")
    _defaults(root, figures)
    world = SubElement(root, "worldbody")
    shapes = _by_body((*figures.collisions, *figures.visuals))
    trunk = SubElement(world, "body", name=TRUNK, pos=_text((0, 0, figures.spawn_height)))
    SubElement(trunk, "freejoint", name=ROOT_JOINT)
    _inertial(trunk, figures.trunk)
    _geoms(trunk, shapes[TRUNK])
    _cameras(trunk, figures)
    for attachment in figures.attachments:
        body = SubElement(trunk, "body", name=attachment.name, pos=_text(attachment.position))
        _geoms(body, shapes[attachment.name])
    for leg in figures.legs:
        _leg(trunk, leg, shapes)
    _actuators(root, figures)
    indent(root)
    return tostring(root, encoding="unicode")


def body_names(figures: Figures) -> tuple[str, ...]:
    """Return every body of the robot, parents before children, in the order of the MJCF."""
    links = [f"{leg.name}_{kind}" for leg in figures.legs for kind in JOINT_KINDS]
    return (TRUNK, *(attachment.name for attachment in figures.attachments), *links)


def _defaults(root: Element, figures: Figures) -> None:
    defaults = SubElement(root, "default")
    # Scene geometry gets the same half margin, so that every pair has the figure. The published
    # evaluation ran on MuJoCo 3.1.6, which took the larger of both margins; since 3.5 they add up.
    SubElement(
        defaults,
        "geom",
        friction=_text(figures.geom_friction),
        margin=_text((figures.contact_margin / 2,)),
    )
    SubElement(
        defaults,
        "joint",
        damping=_text((figures.joint_damping,)),
        armature=_text((figures.armature,)),
        frictionloss=_text((figures.friction_loss,)),
    )


def _leg(trunk: Element, leg: Leg, shapes: dict[str, list[Shape]]) -> None:
    parent = trunk
    for kind, link in zip(JOINT_KINDS, (leg.hip, leg.thigh, leg.calf), strict=True):
        name = f"{leg.name}_{kind}"
        parent = SubElement(parent, "body", name=name, pos=_text(link.position))
        _inertial(parent, link.inertial)
        SubElement(
            parent, "joint", name=f"{name}_joint", axis=_text(link.axis), range=_text(link.range)
        )
        _geoms(parent, shapes[name])


def _inertial(body: Element, inertial: Inertial) -> None:
    SubElement(
        body,
        "inertial",
        pos=_text(inertial.com),
        quat=_text(inertial.quat),
        mass=_text((inertial.mass,)),
        diaginertia=_text(inertial.principal),
    )


def _geoms(body: Element, shapes: Iterable[Shape]) -> None:
    for shape in shapes:
        attributes = {
            "type": shape.kind,
            "size": _text(shape.size),
            "pos": _text(shape.position),
            "quat": _text(shape.quat),
        }
        if shape.name:
            attributes["name"] = shape.name
        if shape.rgba is None:
            attributes |= {"group": str(COLLISION_GROUP), "density": _text((_DENSITY,))}
        else:
            attributes |= {
                "group": str(VISUAL_GROUP),
                "contype": str(_VISUAL_CONTYPE),
                "conaffinity": "0",
                "mass": "0",
                "rgba": _text(shape.rgba),
            }
        SubElement(body, "geom", attributes)


def _cameras(trunk: Element, figures: Figures) -> None:
    for name, mount in figures.cameras.items():
        right, down, _forward = zip(*mount.R_trunk_camera, strict=True)
        axes = (*right, *(-value for value in down))
        SubElement(
            trunk,
            "camera",
            name=name,
            pos=_text(mount.position),
            xyaxes=_text(axes),
            fovy=_text((math.degrees(mount.fovy),)),
        )
    for camera in figures.followers:
        SubElement(
            trunk,
            "camera",
            name=camera.name,
            mode="trackcom",
            pos=_text(camera.position),
            xyaxes=_text((*camera.x_axis, *camera.y_axis)),
            fovy=_text((math.degrees(camera.fovy),)),
        )


def _actuators(root: Element, figures: Figures) -> None:
    actuators = SubElement(root, "actuator")
    limit = (-figures.torque_limit, figures.torque_limit)
    for leg in figures.legs:
        for kind in JOINT_KINDS:
            joint = f"{leg.name}_{kind}_joint"
            SubElement(
                actuators,
                "position",
                name=joint,
                joint=joint,
                kp=_text((figures.kp,)),
                forcerange=_text(limit),
            )


def _by_body(shapes: Iterable[Shape]) -> dict[str, list[Shape]]:
    by_body: dict[str, list[Shape]] = defaultdict(list)
    for shape in shapes:
        by_body[shape.body].append(shape)
    return by_body


def _text(values: Iterable[float]) -> str:
    # `+ 0.0` turns -0.0 into 0.0, so that mirrored figures write the same text.
    return " ".join(repr(float(value) + 0.0) for value in values)
