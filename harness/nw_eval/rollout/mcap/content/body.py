"""The robot's messages of one control step: transforms, joints, the trunk's pose and twist.

Their numbers are rounded to single precision: they are for viewing, the exact ones are in
`/nw/state`, and the zero bits that this leaves compress well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from numpy.typing import NDArray

from nw_eval.rollout.mcap.content.entities import WORLD
from nw_eval.rollout.mcap.form import BLANK_TIME, Form, blank_double
from nw_eval.rollout.mcap.messages import Command, Twist

BodyPoses = Mapping[str, tuple[np.ndarray, np.ndarray]]

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


def rounded(*parts: Any) -> NDArray[np.float64]:
    """Return numbers in a row, of single precision and in the places of double ones."""
    return np.concatenate(parts, axis=None).astype(np.float32).astype("<f8")


def _blank(message: Any, fields: Sequence[str], first: int) -> None:
    for number, field in enumerate(fields, start=first):
        setattr(message, field, blank_double(number))
