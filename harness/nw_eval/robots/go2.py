"""The Unitree Go2 as the published Neverwhere evaluation simulates it.

Figures: the robot files of ziyc/neverwhere (commit 5774a18), read as data. The trunk's mass and
inertia are those that the authors copied from the Go1 (4.801 kg); a real Go2's trunk is about
6.9 kg. Both protocols keep the published figure, so that scores compare.

What it looks like is drawn from primitives, for overlays, logs and viewers; these collide with
nothing.
"""

from __future__ import annotations

import math

from nw_eval.robots.mjcf import LEGS, Figures, Inertial, Leg, make_spec
from nw_eval.robots.published import (
    COLLIDED_FORCE,
    DEFAULT_POSE,
    FELL_TILT,
    FOLLOWERS,
    SEGMENT,
    TRUNK,
    published_cameras,
    published_leg,
)
from nw_eval.robots.spec import Z_TO_X, Z_TO_Y, Quaternion, RobotSpec, Shape, Vector3

_EYE = (0.285, 0.0, 0.175)  # in the trunk; the release's camera stands above the head
_HIP = (0.1934, 0.0465, 0.0)
_THIGH_OFFSET = 0.0955  # of the thigh joint from the hip joint, outwards
_FOOT_RADIUS = 0.022
_HIP_RANGE = (-1.0472, 1.0472)
_FRONT_THIGH_RANGE = (-1.5708, 3.4907)
_REAR_THIGH_RANGE = (-0.5236, 4.5379)
_CALF_RANGE = (-2.7227, -0.83776)
_HIP_QUATS: dict[str, Quaternion] = {
    "FR": (0.498237, 0.505462, 0.499245, 0.497014),
    "FL": (0.497014, 0.499245, 0.505462, 0.498237),
    "RR": (0.499245, 0.497014, 0.498237, 0.505462),
    "RL": (0.505462, 0.498237, 0.497014, 0.499245),
}


_THIGH_QUATS: dict[str, Quaternion] = {
    "R": (0.551623, -0.0200632, 0.0847635, 0.829533),
    "L": (0.829533, 0.0847635, -0.0200632, 0.551623),
}


_CALF_QUATS: dict[str, Quaternion] = {
    "R": (0.703508, -0.00450087, 0.00154099, 0.710672),
    "L": (0.710672, 0.00154099, -0.00450087, 0.703508),
}


def _about_y(angle: float) -> Quaternion:
    return (math.cos(angle / 2), 0.0, math.sin(angle / 2), 0.0)


# Lays the long x axis of the link boxes along z.
_QUARTER_TURN_Y = _about_y(math.pi / 2)


def _leg(name: str) -> Leg:
    side = name[1]
    front = 1.0 if name[0] == "F" else -1.0
    left = 1.0 if side == "L" else -1.0
    hip = Inertial(
        mass=0.678,
        com=(-0.0054 * front, 0.00194 * left, -0.000105),
        principal=(0.00088403, 0.000596003, 0.000479967),
        quat=_HIP_QUATS[name],
    )
    thigh = Inertial(
        mass=1.152,
        com=(-0.00374, -0.0223 * left, -0.0327),
        principal=(0.00594973, 0.00584149, 0.000878787),
        quat=_THIGH_QUATS[side],
    )
    calf = Inertial(
        mass=0.241352,
        com=(0.00629595, -0.000622121 * left, -0.141417),
        principal=(0.0014901, 0.00146356, 5.31397e-05),
        quat=_CALF_QUATS[side],
    )
    thigh_range = _FRONT_THIGH_RANGE if front > 0 else _REAR_THIGH_RANGE
    return published_leg(
        name,
        hip=_HIP,
        thigh_offset=_THIGH_OFFSET,
        ranges=(_HIP_RANGE, thigh_range, _CALF_RANGE),
        inertials=(hip, thigh, calf),
    )


def _collisions() -> tuple[Shape, ...]:
    trunk = (
        Shape(body="trunk", kind="box", name="base", size=(0.1881, 0.04675, 0.057)),
        Shape(
            body="trunk",
            kind="cylinder",
            name="face_head",
            size=(0.05, 0.045),
            position=(0.285, 0.0, 0.01),
        ),
        Shape(
            body="trunk",
            kind="sphere",
            name="face_dome",
            size=(0.047,),
            position=(0.293, 0.0, -0.06),
        ),
    )
    return (*trunk, *(shape for leg in LEGS for shape in _leg_collisions(leg)))


def _leg_collisions(leg: str) -> tuple[Shape, ...]:
    is_left = leg[1] == "L"
    calf = f"{leg}_calf"
    return (
        Shape(
            body=f"{leg}_hip",
            kind="cylinder",
            name=f"{leg}_hip",
            size=(0.046, 0.02),
            position=(0.0, 0.08 if is_left else -0.08, 0.0),
            quat=Z_TO_Y,
        ),
        Shape(
            body=f"{leg}_thigh",
            kind="box",
            name=f"{leg}_thigh",
            size=(SEGMENT / 2, 0.01225, 0.017),
            position=(0.0, 0.0, -SEGMENT / 2),
            quat=_QUARTER_TURN_Y,
        ),
        # The two sides differ by a millimetre or two in the published file.
        Shape(
            body=calf,
            kind="cylinder",
            name=f"{leg}_upper_calf",
            size=(0.012 if is_left else 0.013, 0.06),
            position=(0.008 if is_left else 0.01, 0.0, -0.06),
            quat=_about_y(-0.209 if is_left else -0.2),
        ),
        Shape(
            body=calf,
            kind="cylinder",
            name=f"{leg}_lower_calf",
            size=(0.011, 0.0325),
            position=(0.02, 0.0, -0.148),
            quat=_about_y(0.05),
        ),
        Shape(
            body=calf,
            kind="sphere",
            name=leg,
            size=(_FOOT_RADIUS,),
            position=(-0.002, 0.0, -SEGMENT),
        ),
    )


def _down() -> tuple[Vector3, Vector3, Vector3]:
    """Return R_trunk_camera of a camera that looks ahead and 18.4 degrees down."""
    # The published image axes are x = (0, -1, 0) and y = (0.316, 0, 0.949), normalised on loading.
    length = math.hypot(0.316, 0.949)
    s, c = 0.316 / length, 0.949 / length
    return (0.0, -s, c), (-1.0, 0.0, 0.0), (0.0, -c, -s)


_LIGHT_GREY = (0.78, 0.79, 0.80, 1.0)
_DARK_GREY = (0.24, 0.25, 0.26, 1.0)
_BLACK = (0.07, 0.07, 0.08, 1.0)
_RUBBER = (0.13, 0.13, 0.14, 1.0)
_LENS = (0.22, 0.36, 0.55, 1.0)
_LAMP = (0.92, 0.94, 0.90, 1.0)


def _visuals() -> tuple[Shape, ...]:
    """Return the primitives, in body frames."""
    legs = [shape for leg in LEGS for shape in _visual_leg(leg)]
    return (*_visual_trunk(), *_visual_head(), *legs)


def _visual_trunk() -> list[Shape]:
    motors = [
        Shape(
            body="trunk",
            kind="cylinder",
            size=(0.045, 0.036),
            position=(0.165 * front, 0.0465 * left, 0.0),
            quat=Z_TO_X,
            rgba=_DARK_GREY,
        )
        for front in (1, -1)
        for left in (1, -1)
    ]
    return [
        Shape(body="trunk", kind="box", size=(0.165, 0.056, 0.042), rgba=_LIGHT_GREY),
        Shape(  # rounded back
            body="trunk",
            kind="ellipsoid",
            size=(0.200, 0.058, 0.034),
            position=(0.0, 0.0, 0.036),
            rgba=_LIGHT_GREY,
        ),
        Shape(  # battery, open at the flank
            body="trunk",
            kind="box",
            size=(0.095, 0.060, 0.024),
            position=(-0.005, 0.0, -0.012),
            rgba=_BLACK,
        ),
        Shape(  # belly
            body="trunk",
            kind="box",
            size=(0.150, 0.048, 0.007),
            position=(0.0, 0.0, -0.049),
            rgba=_BLACK,
        ),
        Shape(  # rear panel
            body="trunk",
            kind="box",
            size=(0.010, 0.040, 0.030),
            position=(-0.205, 0.0, 0.002),
            rgba=_DARK_GREY,
        ),
        *motors,
    ]


def _visual_head() -> list[Shape]:
    return [
        Shape(
            body="trunk",
            kind="box",
            size=(0.050, 0.040, 0.034),
            position=(0.232, 0.0, 0.010),
            rgba=_LIGHT_GREY,
        ),
        Shape(  # flat face
            body="trunk",
            kind="ellipsoid",
            size=(0.034, 0.050, 0.046),
            position=(0.285, 0.0, 0.010),
            rgba=_BLACK,
        ),
        Shape(  # dome of the lidar under the chin
            body="trunk",
            kind="ellipsoid",
            size=(0.046, 0.046, 0.044),
            position=(0.293, 0.0, -0.060),
            rgba=_DARK_GREY,
        ),
        Shape(  # front camera
            body="trunk",
            kind="cylinder",
            size=(0.010, 0.004),
            position=(0.318, 0.0, 0.020),
            quat=Z_TO_X,
            rgba=_LENS,
        ),
        Shape(  # front lamp
            body="trunk",
            kind="box",
            size=(0.003, 0.014, 0.004),
            position=(0.318, 0.0, 0.038),
            rgba=_LAMP,
        ),
    ]


def _visual_leg(leg: str) -> list[Shape]:
    left = 1.0 if leg[1] == "L" else -1.0
    hip, thigh, calf = f"{leg}_hip", f"{leg}_thigh", f"{leg}_calf"
    return [
        Shape(  # arm of the hip
            body=hip,
            kind="ellipsoid",
            size=(0.046, 0.040, 0.042),
            position=(0.0, 0.014 * left, 0.0),
            rgba=_DARK_GREY,
        ),
        Shape(  # motor of the thigh
            body=hip,
            kind="cylinder",
            size=(0.046, 0.022),
            position=(0.0, 0.062 * left, 0.0),
            quat=Z_TO_Y,
            rgba=_DARK_GREY,
        ),
        Shape(body=thigh, kind="cylinder", size=(0.044, 0.018), quat=Z_TO_Y, rgba=_LIGHT_GREY),
        Shape(  # motor of the knee, in the thigh's head
            body=thigh,
            kind="cylinder",
            size=(0.028, 0.010),
            position=(0.0, 0.015 * left, 0.0),
            quat=Z_TO_Y,
            rgba=_BLACK,
        ),
        Shape(
            body=thigh,
            kind="ellipsoid",
            size=(0.034, 0.018, 0.122),
            position=(0.002, 0.0, -0.094),
            rgba=_LIGHT_GREY,
        ),
        Shape(
            body=thigh,
            kind="box",
            size=(0.015, 0.013, 0.070),
            position=(0.0, 0.0, -0.135),
            rgba=_LIGHT_GREY,
        ),
        Shape(body=calf, kind="cylinder", size=(0.021, 0.016), quat=Z_TO_Y, rgba=_BLACK),
        Shape(
            body=calf,
            kind="cylinder",
            size=(0.0125, 0.060),
            position=(0.009, 0.0, -0.060),
            quat=(math.cos(0.1), 0.0, -math.sin(0.1), 0.0),
            rgba=_BLACK,
        ),
        Shape(
            body=calf,
            kind="cylinder",
            size=(0.0105, 0.045),
            position=(0.012, 0.0, -0.160),
            quat=(math.cos(0.1), 0.0, math.sin(0.1), 0.0),
            rgba=_BLACK,
        ),
        Shape(
            body=calf,
            kind="ellipsoid",
            size=(0.023, 0.021, 0.022),
            position=(-0.002, 0.0, -0.213),
            rgba=_RUBBER,
        ),
    ]


FIGURES = Figures(
    name="go2",
    trunk=TRUNK,
    attachments=(),
    legs=tuple(_leg(name) for name in LEGS),
    collisions=_collisions(),
    visuals=_visuals(),
    cameras=published_cameras(_EYE, _down()),
    followers=FOLLOWERS,
    spawn_height=0.4,
    kp=30.0,
    joint_damping=0.6,
    armature=0.01,
    friction_loss=0.2,
    torque_limit=23.7,
    geom_friction=(1.0, 0.3, 0.3),
    contact_margin=0.001,
    default_pose=DEFAULT_POSE,
    monitored=("face_head", "face_dome", "base"),
    published_monitored=("face_head", "face_dome", "base"),
    fell_tilt=FELL_TILT,
    collided_force=COLLIDED_FORCE,
    height_camera_offset=(-0.00341, -0.00162, 25.03764),
)


def go2() -> RobotSpec:
    """Return the Go2: 13.086 kg, 12 position servos with kp 30 and limits of 23.7 N m."""
    return make_spec(FIGURES)
