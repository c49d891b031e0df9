"""The robot's messages of control steps: transforms, joints, the trunk's pose and twist."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from numpy.typing import NDArray

from nw_eval.rollout.mcap.content.entities import WORLD
from nw_eval.rollout.mcap.form import BLANK_TIME, Form, blank_double
from nw_eval.rollout.mcap.messages import Command, Twist
from nw_eval.rollout.mcap.sheet import rounded

HEADING = "heading"
"""The frame of commands: the trunk's origin, level, turned by the trunk's yaw only."""


def transforms_form(frames: Sequence[str]) -> Form:
    """Return the form of `/tf`: for each frame x y z (m) and quaternion w x y z in the world."""
    message = FrameTransforms()
    for number, name in enumerate(frames):
        added = message.transforms.add(
            timestamp=BLANK_TIME, parent_frame_id=WORLD, child_frame_id=name
        )
        _blank(added.translation, "xyz", 7 * number)
        _blank(added.rotation, "wxyz", 7 * number + 3)
    return Form.of_doubles(message, 7 * len(frames))


def joints_form(names: Sequence[str]) -> Form:
    """Return the form of `/robot/joints`: for each joint rad, rad/s and N m."""
    message = JointStates(timestamp=BLANK_TIME)
    for number, name in enumerate(names):
        joint = message.joints.add(name=name)
        joint.position = blank_double(3 * number)
        joint.velocity = blank_double(3 * number + 1)
        joint.effort = blank_double(3 * number + 2)
    return Form.of_doubles(message, 3 * len(names))


def odom_form() -> Form:
    """Return the form of `/robot/odom`: x y z (m) and quaternion w x y z in the world."""
    message = PoseInFrame(timestamp=BLANK_TIME, frame_id=WORLD)
    _blank(message.pose.position, "xyz", 0)
    _blank(message.pose.orientation, "wxyz", 3)
    return Form.of_doubles(message, 7)


def twist_form(trunk: str) -> Form:
    """Return the form of `/robot/twist`: velocity (m/s), angular velocity (rad/s) in the trunk."""
    message = Twist(timestamp=BLANK_TIME, frame_id=trunk)
    _blank(message.linear, "xyz", 0)
    _blank(message.angular, "xyz", 3)
    return Form.of_doubles(message, 6)


def command_form() -> Form:
    """Return the form of `/robot/command`: vx, vy (m/s), yaw rate (rad/s), heading error (rad)."""
    message = Command(timestamp=BLANK_TIME, frame_id=HEADING)
    _blank(message, ("forward", "left", "yaw_rate", "heading_error"), 0)
    return Form.of_doubles(message, 4)


Poses = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Positions (N, 3) and quaternions wxyz (N, 4) of a model's bodies in the world."""


def transform_rows(
    notes: Sequence[Poses], bodies: Sequence[int], cameras: Sequence[NDArray[np.float64]]
) -> NDArray[np.float64]:
    """Return the numbers of `/tf`.

    Args:
        notes: where everything is.
        bodies: numbers of the robot's bodies, trunk first.
        cameras: poses in the trunk, (7,) each, which follow the bodies.
    """
    poses = _poses(notes, bodies)
    trunk = poses[:, 0]
    mounted = [
        np.concatenate(
            (
                trunk[:, :3] + _turned(trunk[:, 3:], camera[:3]),
                _product(trunk[:, 3:], camera[3:]),
            ),
            axis=1,
        )
        for camera in cameras
    ]
    return rounded(np.concatenate((poses, *(each[:, np.newaxis] for each in mounted)), axis=1))


def joint_rows(notes: Sequence[Sequence[NDArray[np.float64]]]) -> NDArray[np.float64]:
    """Return the numbers of `/robot/joints` from angles, velocities and torques, (J) each."""
    return rounded(np.array(notes).transpose(0, 2, 1))


def odom_rows(notes: Sequence[Poses], trunk: int) -> NDArray[np.float64]:
    """Return the numbers of `/robot/odom`, from where everything is and the trunk's number."""
    return rounded(_poses(notes, [trunk]))


def twist_rows(
    notes: Sequence[tuple[Poses, NDArray[np.float64]]], trunk: int
) -> NDArray[np.float64]:
    """Return the numbers of `/robot/twist`.

    Args:
        notes: where everything is; and velocity in the world, angular velocity in the trunk, (6,).
        trunk: the trunk's number.
    """
    rates = np.array([rate for _, rate in notes])
    backwards = np.array([quats[trunk] for (_, quats), _ in notes]) * (1.0, -1.0, -1.0, -1.0)
    return rounded(np.concatenate((_turned(backwards, rates[:, :3]), rates[:, 3:]), axis=1))


def _poses(notes: Sequence[Poses], bodies: Sequence[int]) -> NDArray[np.float64]:
    """Return poses (N, B, 7) of some bodies: position, quaternion wxyz."""
    positions = np.array([places for places, _ in notes])
    quats = np.array([quats for _, quats in notes])
    return np.concatenate((positions[:, bodies], quats[:, bodies]), axis=2)


def _turned(quats: NDArray[np.float64], vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return vectors (3,) or (N, 3) turned by unit quaternions (N, 4)."""
    scalar, axis = quats[:, :1], quats[:, 1:]
    across = 2.0 * np.cross(axis, vectors)
    return vectors + scalar * across + np.cross(axis, across)


def _product(quats: NDArray[np.float64], quat: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return quaternions (N, 4), each times one (4,)."""
    w, x, y, z = quats.T
    a, b, c, d = quat
    return np.stack(
        (
            w * a - x * b - y * c - z * d,
            w * b + x * a + y * d - z * c,
            w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        ),
        axis=1,
    )


def _blank(message: Any, fields: Sequence[str], first: int) -> None:
    for number, field in enumerate(fields, start=first):
        setattr(message, field, blank_double(number))
