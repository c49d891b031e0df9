"""The robot's messages of control steps: transforms, joints, the trunk's pose and twist."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from numpy.typing import NDArray

from nw_eval.rollout.mcap.content.entities import WORLD
from nw_eval.rollout.mcap.form import BLANK_TIME, Form, blank_double
from nw_eval.rollout.mcap.messages import Command, Twist

HEADING = "heading"
"""The frame of commands: the trunk's origin, level, turned by the trunk's yaw only."""


@lru_cache(maxsize=8)
def transforms_form(frames: tuple[str, ...]) -> Form:
    """Return the form of `/tf`: for each frame x y z (m) and quaternion w x y z in the world."""
    message = FrameTransforms()
    for number, name in enumerate(frames):
        added = message.transforms.add(
            timestamp=BLANK_TIME, parent_frame_id=WORLD, child_frame_id=name
        )
        _blank(added.translation, "xyz", 7 * number)
        _blank(added.rotation, "wxyz", 7 * number + 3)
    return Form.of_doubles(message, 7 * len(frames))


@lru_cache(maxsize=8)
def joints_form(names: tuple[str, ...]) -> Form:
    """Return the form of `/robot/joints`: for each joint rad, rad/s and N m."""
    message = JointStates(timestamp=BLANK_TIME)
    for number, name in enumerate(names):
        joint = message.joints.add(name=name)
        joint.position = blank_double(3 * number)
        joint.velocity = blank_double(3 * number + 1)
        joint.effort = blank_double(3 * number + 2)
    return Form.of_doubles(message, 3 * len(names))


@lru_cache(maxsize=8)
def odom_form() -> Form:
    """Return the form of `/robot/odom`: x y z (m) and quaternion w x y z in the world."""
    message = PoseInFrame(timestamp=BLANK_TIME, frame_id=WORLD)
    _blank(message.pose.position, "xyz", 0)
    _blank(message.pose.orientation, "wxyz", 3)
    return Form.of_doubles(message, 7)


@lru_cache(maxsize=8)
def twist_form(trunk: str) -> Form:
    """Return the form of `/robot/twist`: velocity (m/s), angular velocity (rad/s) in the trunk."""
    message = Twist(timestamp=BLANK_TIME, frame_id=trunk)
    _blank(message.linear, "xyz", 0)
    _blank(message.angular, "xyz", 3)
    return Form.of_doubles(message, 6)


@lru_cache(maxsize=8)
def command_form() -> Form:
    """Return the form of `/robot/command`: vx, vy (m/s), yaw rate (rad/s), heading error (rad)."""
    message = Command(timestamp=BLANK_TIME, frame_id=HEADING)
    _blank(message, ("forward", "left", "yaw_rate", "heading_error"), 0)
    return Form.of_doubles(message, 4)


Array = NDArray[np.float64]
_RATES = 6  # numbers of a velocity and an angular velocity


class BodyForms:
    """The robot's own messages of control steps.

    Args:
        names: of the robot's bodies, trunk first.
        bodies: their numbers among the model's.
        in_model: how many bodies the model has.
        joints: names.
        cameras: poses in the trunk, (7,), by the name of the frame.

    Attributes:
        forms: by topic, in the order of `numbers`.
        width: numbers in a row for `numbers`.
    """

    def __init__(
        self,
        *,
        names: tuple[str, ...],
        bodies: Sequence[int],
        in_model: int,
        joints: tuple[str, ...],
        cameras: Mapping[str, Array],
    ) -> None:
        self.forms: dict[str, Form] = {
            "/tf": transforms_form((*names, *cameras)),
            "/robot/joints": joints_form(joints),
            "/robot/odom": odom_form(),
            "/robot/twist": twist_form(names[0]),
        }
        self.width = 7 * in_model + 3 * len(joints) + _RATES
        self._bodies = list(bodies)
        self._joints = len(joints)
        self._mounts = tuple(cameras.values())

    def trunk(self, rows: Array) -> Array:
        """Return where the trunk is in the world, (N, 3) m, from rows as for `numbers`."""
        first = 3 * self._bodies[0]
        return rows[:, first : first + 3]

    def numbers(self, rows: Array) -> tuple[Array, ...]:
        """Return what is filled into each form, (N, ...).

        Args:
            rows: (N, 7 A + 3 J + 6) for the A bodies of the model: positions (m) of all, then
                quaternions wxyz; angles (rad), then velocities (rad/s) of the joints; velocity of
                the trunk in the world (m/s), angular in its own frame (rad/s); torques (N m).
        """
        count, joints = len(rows), self._joints
        places, angles, speeds, rates, torques = np.split(
            rows, np.cumsum((-3 * joints - _RATES, joints, joints, _RATES)), axis=1
        )
        poses = _poses(places)[:, self._bodies]
        trunk = poses[:, 0]
        return (
            rounded(np.concatenate((poses, mounted_poses(trunk, self._mounts)), axis=1)),
            rounded(np.stack((angles, speeds, torques), axis=2)).reshape(count, -1),
            rounded(trunk),
            rounded(trunk_rates(trunk, rates)),
        )


def rounded(numbers: NDArray[Any]) -> Array:
    """Return numbers of single precision in the places of double ones.

    They are for viewing, the exact ones are in `/nw/state`; the zero bits that this leaves compress
    well.
    """
    return numbers.astype(np.float32).astype("<f8")


def mounted_poses(trunk: Array, mounts: Sequence[Array]) -> Array:
    """Return poses (N, M, 7) of what is mounted on the trunk.

    Args:
        trunk: its poses, (N, 7): position, quaternion wxyz.
        mounts: poses in the trunk, (7,) each.
    """
    found = np.empty((len(trunk), len(mounts), 7))
    for number, mount in enumerate(mounts):
        found[:, number, :3] = trunk[:, :3] + _turned(trunk[:, 3:], mount[:3])
        found[:, number, 3:] = _product(trunk[:, 3:], mount[3:])
    return found


def trunk_rates(trunk: Array, rates: Array) -> Array:
    """Return velocity and angular velocity in the trunk (N, 6).

    Args:
        trunk: its poses, (N, 7): position, quaternion wxyz.
        rates: velocity in the world, angular velocity in the trunk, (N, 6).
    """
    backwards = trunk[:, 3:] * (1.0, -1.0, -1.0, -1.0)
    return np.concatenate((_turned(backwards, rates[:, :3]), rates[:, 3:]), axis=1)


def _poses(places: Array) -> Array:
    """Return poses (N, A, 7) from all positions, then all quaternions, (N, 7 A)."""
    count, bodies = len(places), places.shape[1] // 7
    positions, quats = places[:, : 3 * bodies], places[:, 3 * bodies :]
    return np.concatenate(
        (positions.reshape(count, bodies, 3), quats.reshape(count, bodies, 4)), axis=2
    )


def _turned(quats: NDArray[np.float64], vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return vectors (3,) or (N, 3) turned by unit quaternions (N, 4)."""
    scalar, axis = quats[:, :1], quats[:, 1:]
    across = 2.0 * _cross(axis, vectors)
    return vectors + scalar * across + _cross(axis, across)


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the cross products of (N, 3) with (3,) or (N, 3): `np.cross` takes longer."""
    found = np.empty_like(a)
    for to, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        found[:, to] = a[:, i] * b[..., j] - a[:, j] * b[..., i]
    return found


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
