"""What the two published robots have in common: the robot files of ziyc/neverwhere, 5774a18."""

from __future__ import annotations

import math

from nw_eval.robots.mjcf import FollowingCamera, Inertial, Leg, Link
from nw_eval.robots.spec import CameraMount, Vector3

TRUNK = Inertial(
    mass=4.801,
    com=(0.0116053, 0.00442221, 0.000106692),
    principal=(0.0447997, 0.0366257, 0.0162187),
    quat=(0.0111438, 0.707126, -0.00935374, 0.706938),
)
"""The Go1's, which the authors copied to the Go2."""

FELL_TILT = 1.2
"""Radians of roll or pitch, beyond which it fell."""

COLLIDED_FORCE = 10.0
"""Newtons on one monitored geom, beyond which it collided."""

SEGMENT = 0.213
"""Length of thigh and calf, metres."""

DEFAULT_POSE = (-0.1, 0.8, -1.5, 0.1, 0.8, -1.5, -0.1, 1.0, -1.5, 0.1, 1.0, -1.5)
"""Radians, in the order of the joints."""

FOLLOWERS = (
    FollowingCamera(
        name="heightmap",
        position=(0.0, 0.0, 25.0),
        x_axis=(0.0, -1.0, 0.0),
        y_axis=(1.0, 0.0, 0.0),
        fovy=math.radians(6.0),
    ),
    FollowingCamera(
        name="tracking",
        position=(0.0, -1.0, 1.0),
        x_axis=(1.0, 0.0, 0.0),
        y_axis=(0.0, 1.0, 1.0),
        fovy=math.radians(60.0),
    ),
    FollowingCamera(
        name="tracking-2",
        position=(0.0, -1.0, 0.0),
        x_axis=(1.0, 0.0, 0.0),
        y_axis=(0.0, 0.0, 1.0),
        fovy=math.radians(60.0),
    ),
)
"""Cameras of the published scandots and videos."""


def published_leg(
    name: str,
    *,
    hip: Vector3,
    thigh_offset: float,
    ranges: tuple[tuple[float, float], ...],
    inertials: tuple[Inertial, Inertial, Inertial],
) -> Leg:
    """Return a leg: the hip turns about x, thigh and calf about y.

    Args:
        name: one of `mjcf.LEGS`.
        hip: of the front left leg, in the trunk, metres.
        thigh_offset: of the thigh's joint from the hip's, outwards, metres.
        ranges: of hip, thigh and calf, rad.
        inertials: likewise, of this leg.
    """
    front = 1.0 if name[0] == "F" else -1.0
    left = 1.0 if name[1] == "L" else -1.0
    positions = (
        (hip[0] * front, hip[1] * left, hip[2]),
        (0.0, thigh_offset * left, 0.0),
        (0.0, 0.0, -SEGMENT),
    )
    axes = ((1, 0, 0), (0, 1, 0), (0, 1, 0))
    links = [
        Link(position=position, axis=axis, range=reach, inertial=inertial)
        for position, axis, reach, inertial in zip(positions, axes, ranges, inertials, strict=True)
    ]
    return Leg(name=name, hip=links[0], thigh=links[1], calf=links[2])


def published_cameras(
    position: Vector3, rotation: tuple[Vector3, Vector3, Vector3]
) -> dict[str, CameraMount]:
    """Return the cameras of a robot, which all look out of one place.

    Args:
        position: in the trunk, metres.
        rotation: R_trunk_camera, row by row.
    """
    # Published names: ego-rgb, ego-rgb-render, realsense, realsense-rgb, realsense-rgb-render.
    views = {
        "ego": 90.0,
        "ego-render": 92.69673787219053,
        "realsense": 56.18593669466556,
        "realsense-rgb": 42.61,
        "realsense-rgb-render": 45.1729792,
    }
    return {
        name: CameraMount(position=position, R_trunk_camera=rotation, fovy=math.radians(degrees))
        for name, degrees in views.items()
    }
