"""The Unitree Go1 as the published Neverwhere evaluation simulates it.

Figures: the robot files of ziyc/neverwhere (commit 5774a18), read as data. Two things in them are
easily missed and kept, because they change what a policy meets: a 1 kg cube for a head, and a
trunk box that is shorter than the trunk one sees. The hips collide with nothing.

What it looks like is drawn from primitives, for overlays, logs and viewers; these collide with
nothing.
"""

from __future__ import annotations

from nw_eval.robots.mjcf import LEGS, Attachment, Figures, Inertial, Leg, make_spec
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
from nw_eval.robots.spec import Z_TO_X, Z_TO_Y, Quaternion, RobotSpec, Shape

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
_SILVER = (0.80, 0.82, 0.84, 1.0)
_GRAPHITE = (0.30, 0.31, 0.33, 1.0)
_BLACK = (0.07, 0.07, 0.08, 1.0)
_RUBBER = (0.13, 0.13, 0.14, 1.0)
_LENS = (0.22, 0.36, 0.55, 1.0)
_LIGHT = (0.25, 0.80, 0.95, 1.0)


def _visuals() -> tuple[Shape, ...]:
    """Return the primitives, in body frames."""
    legs = [shape for leg in LEGS for shape in _visual_leg(leg)]
    return (*_visual_trunk(), *_visual_head(), *legs)


def _visual_trunk() -> list[Shape]:
    motors = [
        Shape(
            body="trunk",
            kind="cylinder",
            size=(0.043, 0.034),
            position=(0.158 * front, 0.04675 * left, 0.0),
            quat=Z_TO_X,
            rgba=_GRAPHITE,
        )
        for front in (1, -1)
        for left in (1, -1)
    ]
    return [
        Shape(body="trunk", kind="ellipsoid", size=(0.225, 0.058, 0.056), rgba=_SILVER),
        Shape(body="trunk", kind="box", size=(0.135, 0.057, 0.044), rgba=_SILVER),
        Shape(  # curved back
            body="trunk",
            kind="ellipsoid",
            size=(0.185, 0.055, 0.030),
            position=(0.0, 0.0, 0.040),
            rgba=_SILVER,
        ),
        Shape(  # battery bay, along the flanks
            body="trunk",
            kind="box",
            size=(0.110, 0.060, 0.020),
            position=(-0.005, 0.0, -0.018),
            rgba=_GRAPHITE,
        ),
        Shape(  # carrying rail on the back
            body="trunk",
            kind="box",
            size=(0.095, 0.018, 0.007),
            position=(-0.01, 0.0, 0.067),
            rgba=_BLACK,
        ),
        Shape(
            body="trunk",
            kind="box",
            size=(0.130, 0.046, 0.007),
            position=(0.0, 0.0, -0.051),
            rgba=_BLACK,
        ),
        Shape(  # rear panel
            body="trunk",
            kind="box",
            size=(0.008, 0.024, 0.024),
            position=(-0.219, 0.0, 0.004),
            rgba=_BLACK,
        ),
        # The four motors that swing the legs sideways close the trunk at both ends.
        *motors,
    ]


def _visual_head() -> list[Shape]:
    eyes = [
        Shape(
            body="trunk",
            kind="cylinder",
            size=(0.010, 0.004),
            position=(0.3155, side * 0.019, 0.026),
            quat=Z_TO_X,
            rgba=_LENS,
        )
        for side in (1, -1)
    ]
    return [
        Shape(  # neck
            body="trunk",
            kind="box",
            size=(0.045, 0.034, 0.030),
            position=(0.200, 0.0, 0.018),
            rgba=_SILVER,
        ),
        Shape(
            body="trunk",
            kind="ellipsoid",
            size=(0.062, 0.058, 0.050),
            position=(0.246, 0.0, 0.020),
            rgba=_SILVER,
        ),
        Shape(  # glossy face
            body="trunk",
            kind="ellipsoid",
            size=(0.044, 0.051, 0.041),
            position=(0.276, 0.0, 0.017),
            rgba=_BLACK,
        ),
        Shape(  # light under the eyes
            body="trunk",
            kind="box",
            size=(0.004, 0.018, 0.0025),
            position=(0.3145, 0.0, 0.003),
            rgba=_LIGHT,
        ),
        *eyes,
    ]


def _visual_leg(leg: str) -> list[Shape]:
    left = 1.0 if leg[1] == "L" else -1.0
    hip, thigh, calf = f"{leg}_hip", f"{leg}_thigh", f"{leg}_calf"
    return [
        Shape(  # arm of the hip
            body=hip,
            kind="ellipsoid",
            size=(0.044, 0.036, 0.040),
            position=(0.0, 0.012 * left, 0.0),
            rgba=_GRAPHITE,
        ),
        Shape(  # motor of the thigh
            body=hip,
            kind="cylinder",
            size=(0.046, 0.020),
            position=(0.0, 0.044 * left, 0.0),
            quat=Z_TO_Y,
            rgba=_GRAPHITE,
        ),
        Shape(body=thigh, kind="cylinder", size=(0.043, 0.017), quat=Z_TO_Y, rgba=_SILVER),
        Shape(  # motor of the knee, in the thigh's head
            body=thigh,
            kind="cylinder",
            size=(0.027, 0.010),
            position=(0.0, 0.014 * left, 0.0),
            quat=Z_TO_Y,
            rgba=_BLACK,
        ),
        Shape(
            body=thigh,
            kind="ellipsoid",
            size=(0.033, 0.016, 0.120),
            position=(0.004, 0.0, -0.092),
            rgba=_SILVER,
        ),
        Shape(
            body=thigh,
            kind="box",
            size=(0.014, 0.012, 0.070),
            position=(0.0, 0.0, -0.135),
            rgba=_SILVER,
        ),
        Shape(  # knee
            body=calf, kind="cylinder", size=(0.020, 0.016), quat=Z_TO_Y, rgba=_BLACK
        ),
        Shape(
            body=calf,
            kind="ellipsoid",
            size=(0.017, 0.011, 0.070),
            position=(0.004, 0.0, -0.052),
            rgba=_BLACK,
        ),
        Shape(
            body=calf, kind="cylinder", size=(0.0095, 0.096), position=(0, 0, -0.110), rgba=_BLACK
        ),
        Shape(
            body=calf, kind="cylinder", size=(0.013, 0.014), position=(0, 0, -0.190), rgba=_SILVER
        ),
        Shape(
            body=calf,
            kind="ellipsoid",
            size=(0.021, 0.019, 0.021),
            position=(0, 0, -0.213),
            rgba=_RUBBER,
        ),
    ]


FIGURES = Figures(
    name="go1",
    trunk=TRUNK,
    attachments=(Attachment(name="face", position=_HEAD),),
    legs=tuple(_leg(name) for name in LEGS),
    collisions=_collisions(),
    visuals=_visuals(),
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
    monitored=("face", "trunk"),
    published_monitored=("face",),
    fell_tilt=FELL_TILT,
    collided_force=COLLIDED_FORCE,
    height_camera_offset=(-0.02443, -0.00170, 25.03206),
)


def go1() -> RobotSpec:
    """Return the Go1: 12.986 kg, 12 position servos with kp 20 and limits of 23.7 N m."""
    return make_spec(FIGURES)
