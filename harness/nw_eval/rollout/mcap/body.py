"""The robot's messages of one control step: transforms, joints, trunk pose.

The messages are built once and filled again, because building them anew costs more than a
physics step. Their numbers are rounded to single precision: they are for viewing, the exact ones
are in `/nw/state`, and the zero bits that this leaves compress well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame

from nw_eval.rollout.mcap.entities import WORLD
from nw_eval.rollout.mcap.stamps import stamp

BodyPoses = Mapping[str, tuple[np.ndarray, np.ndarray]]


class BodyMessages:
    """Templates for `/tf`, `/robot/joints` and `/robot/odom`."""

    def __init__(self, joints: Sequence[str]) -> None:
        self._transforms = FrameTransforms()
        self._frames: tuple[str, ...] = ()
        self._joints = JointStates()
        for name in joints:
            self._joints.joints.add(name=name)
        self._odom = PoseInFrame(frame_id=WORLD)

    def transforms(self, time_ns: int, poses: BodyPoses) -> Any:
        """Return frames in the world: name to position (3) m and quaternion wxyz."""
        if tuple(poses) != self._frames:
            self._frames = tuple(poses)
            del self._transforms.transforms[:]
            for name in self._frames:
                self._transforms.transforms.add(parent_frame_id=WORLD, child_frame_id=name)
        when = stamp(time_ns)
        # All frames at once: rounding them one by one costs more than filling them in.
        positions = np.array([position for position, _ in poses.values()], np.float32).tolist()
        quats = np.array([quat for _, quat in poses.values()], np.float32).tolist()
        rows = zip(self._transforms.transforms, positions, quats, strict=True)
        for message, position, quat in rows:
            message.timestamp.CopyFrom(when)
            _fill(message.translation, message.rotation, position, quat)
        return self._transforms

    def joints(
        self, time_ns: int, position: np.ndarray, velocity: np.ndarray, torque: np.ndarray
    ) -> Any:
        """Return joint angles (12) rad, velocities (12) rad/s and torques (12) N m."""
        self._joints.timestamp.CopyFrom(stamp(time_ns))
        rows = np.stack([position, velocity, torque], axis=1).astype(np.float32).tolist()
        for message, (angle, speed, effort) in zip(self._joints.joints, rows, strict=True):
            message.position, message.velocity, message.effort = angle, speed, effort
        return self._joints

    def odom(self, time_ns: int, position: np.ndarray, quat: np.ndarray) -> Any:
        """Return the trunk's pose in the world: (3) m, quaternion wxyz."""
        self._odom.timestamp.CopyFrom(stamp(time_ns))
        rounded = (np.asarray(part, np.float32).tolist() for part in (position, quat))
        _fill(self._odom.pose.position, self._odom.pose.orientation, *rounded)
        return self._odom


def _fill(vector: Any, rotation: Any, position: list[float], quat: list[float]) -> None:
    vector.x, vector.y, vector.z = position
    rotation.w, rotation.x, rotation.y, rotation.z = quat
