"""The Unitree Go1 as the published Neverwhere evaluation simulates it.

Figures: the robot files of ziyc/neverwhere (commit 5774a18), read as data. Two things in them are
easily missed and kept, because they change what a policy meets: a 1 kg cube for a head, and a
trunk box that is shorter than the trunk one sees. The hips collide with nothing.
"""

from __future__ import annotations

from nw_eval.robots.figures import Attachment, Figures, Inertial, Leg
from nw_eval.robots.go1_visuals import go1_visuals
from nw_eval.robots.make import make_spec
from nw_eval.robots.published import (
    DEFAULT_POSE,
    FOLLOWERS,
    SEGMENT,
    TRUNK,
    published_cameras,
    published_leg,
)
from nw_eval.robots.spec import LEGS, Z_TO_X, Quaternion, RobotSpec, Shape

_HEAD = (0.27, 0.0, 0.015)  # in the trunk; the camera looks out of its middle
_HIP = (0.1881, 0.04675, 0.0)
_THIGH_OFFSET = 0.08  # of the thigh joint from the hip joint, outwards
_FOOT_RADIUS = 0.02

_HIP_RANGE = (-0.802851, 0.802851)
_THIGH_RANGE = (-1.0472, 4.18879)
_CALF_RANGE = (-2.69653, -0.916298)

_HIP_QUATS: dict[str, Quaternion] = {
    "FR": (0.467526, 0.531662, -0.466259, 0.530431),
    "FL": (0.531662, 0.467526, -0.530431, 0.466259),
    "RR": (0.530431, 0.466259, -0.531662, 0.467526),
    "RL": (0.466259, 0.530431, -0.467526, 0.531662),
}


def _leg(name: str) -> Leg:
    front = 1.0 if name[0] == "F" else -1.0
    left = 1.0 if name[1] == "L" else -1.0
    hip = Inertial(
        mass=0.679292,
        com=(-0.00406411 * front, 0.0193463 * left, 4.50733e-06),
        principal=(0.00131334, 0.00122648, 0.000728484),
        quat=_HIP_QUATS[name],
    )
    thigh = Inertial(
        mass=0.898919,
        com=(-0.003468, -0.018947 * left, -0.032736),
        principal=(0.00542178, 0.00514246, 0.000998869),
        quat=(0.999266, -0.00067676 * left, -0.0382978, -0.000639813 * left),
    )
    calf = Inertial(
        mass=0.218015,
        com=(0.00455603, 0.0009473, -0.147239),
        principal=(0.00399678, 0.00398122, 3.99428e-05),
        quat=(0.762045, 0.00970173, 0.0180098, 0.647201),
    )
    return published_leg(
        name,
        hip=_HIP,
        thigh_offset=_THIGH_OFFSET,
        ranges=(_HIP_RANGE, _THIGH_RANGE, _CALF_RANGE),
        inertials=(hip, thigh, calf),
    )


def _collisions() -> tuple[Shape, ...]:
    shapes = [
        Shape(body="trunk", kind="box", name="trunk", size=(0.13, 0.04675, 0.057)),
        Shape(body="face", kind="box", name="face", size=(0.05, 0.05, 0.05)),
    ]
    middle = (0.0, 0.0, -SEGMENT / 2)
    for leg in LEGS:
        shapes += [
            Shape(
                body=f"{leg}_{kind}",
                kind="box",
                name=f"{leg}_{kind}",
                size=(SEGMENT / 2, *cross_section),
                position=middle,
                quat=Z_TO_X,  # and x to z, along which the long axis of a link's box lies
            )
            for kind, cross_section in (("thigh", (0.01225, 0.017)), ("calf", (0.008, 0.008)))
        ]
        shapes.append(
            Shape(
                body=f"{leg}_calf",
                kind="sphere",
                name=leg,
                size=(_FOOT_RADIUS,),
                position=(0.0, 0.0, -SEGMENT),
            )
        )
    return tuple(shapes)


# In the head, looking along x, the image upright.
_AHEAD = ((0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0))

FIGURES = Figures(
    name="go1",
    trunk=TRUNK,
    attachments=(Attachment(name="face", position=_HEAD),),
    legs=tuple(_leg(name) for name in LEGS),
    collisions=_collisions(),
    visuals=go1_visuals(),
    cameras=published_cameras(_HEAD, _AHEAD),
    followers=FOLLOWERS,
    spawn_height=0.4,
    kp=20.0,
    joint_damping=0.5,
    armature=0.01,
    friction_loss=0.2,
    torque_limit=23.7,
    geom_friction=(1.0, 0.3, 0.3),
    contact_margin=0.001,
    default_pose=DEFAULT_POSE,
    monitored_geoms=("face", "trunk"),
    published_monitored_geoms=("face",),
    height_camera_offset=(-0.02443, -0.00170, 25.03206),
)


def go1() -> RobotSpec:
    """Return the Go1: 12.986 kg, 12 position servos with kp 20 and limits of 23.7 N m."""
    return make_spec(FIGURES)
