"""A reference motion on its robot, at the rate of the control steps, and where it lies in a trial.

Quaternions are w, x, y, z. Errors of bodies are those of HybridRobotics/whole_body_tracking
(`tasks/tracking/mdp/commands.py`): the motion is first brought to where the robot's anchor is, at
the height of the motion's own, and turned to its heading.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from nw_base import same_bits
from nw_sim.tasks.task import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Reference:
    """N frames of a motion, one for each control step; J joints in the robot's order, B bodies.

    Attributes:
        joint_positions: (N, J) rad.
        joint_velocities: (N, J) rad/s.
        root: (N, 13) position, m, quaternion, linear velocity, m/s, and angular velocity, rad/s, of
            the robot's root in the motion's world.
        bodies: names of the bodies whose errors count.
        positions: (N, B, 3) m of their origins, in the motion's world.
        quats: (N, B, 4) of them.
        anchor: name of the body that the policy compares; it has its own poses below.
        anchor_positions: (N, 3) m.
        anchor_quats: (N, 4).
        ends: indices in `bodies` of the end effectors.
    """

    joint_positions: Array
    joint_velocities: Array
    root: Array
    bodies: tuple[str, ...]
    positions: Array
    quats: Array
    anchor: str
    anchor_positions: Array
    anchor_quats: Array
    ends: tuple[int, ...]

    def __len__(self) -> int:
        return len(self.joint_positions)


class Frame(NamedTuple):
    """One frame of a motion, where it lies in the trial's world."""

    number: int
    joint_positions: Array  # (J,) rad
    joint_velocities: Array  # (J,) rad/s
    root_position: Array  # (3,) m
    root_quat: Array  # (4,)
    anchor_position: Array  # (3,) m
    anchor_quat: Array  # (4,)
    positions: Array  # (B, 3) m
    quats: Array  # (B, 4)


class PlacedReference:
    """A motion that begins at a frame of it, with that frame's root over a point of the scene.

    Args:
        motion: which one.
        start: number of the frame that belongs to the trial's start.
        place: x, y of the root there, and height of the ground, m.
        yaw: heading of the root there, rad.

    Attributes:
        motion: as given.
        start: as given.
    """

    def __init__(
        self, motion: Reference, *, start: int, place: tuple[float, float, float], yaw: float
    ) -> None:
        self.motion, self.start = motion, start
        self._from = np.array([*motion.root[start, :2].tolist(), 0.0])
        self._to = np.array(place)
        half = (yaw - heading(motion.root[start, 3:7])) / 2.0
        self._turn = np.array([math.cos(half), 0.0, 0.0, math.sin(half)])

    def at(self, step: int) -> Frame:
        """Return the frame that belongs to a control step, from 0; the first or last beyond it."""
        motion = self.motion
        number = min(max(self.start + step, 0), len(motion) - 1)
        return Frame(
            number=number,
            joint_positions=motion.joint_positions[number],
            joint_velocities=motion.joint_velocities[number],
            root_position=self._moved(motion.root[number, :3]),
            root_quat=product(self._turn, motion.root[number, 3:7]),
            anchor_position=self._moved(motion.anchor_positions[number]),
            anchor_quat=product(self._turn, motion.anchor_quats[number]),
            positions=self._moved(motion.positions[number]),
            quats=product(self._turn, motion.quats[number]),
        )

    def velocities(self, step: int) -> tuple[Array, Array]:
        """Return linear, m/s, and angular velocity, rad/s, of the root in the world, (3,) each."""
        row = self.motion.root[min(max(self.start + step, 0), len(self.motion) - 1)]
        return turned(self._turn, row[7:10]), turned(self._turn, row[10:13])

    def _moved(self, positions: Array) -> Array:
        return turned(self._turn, positions - self._from) + self._to


class Errors(NamedTuple):
    """How far a robot is from a frame."""

    joints: float  # rad, mean of the absolute errors
    position: float  # m, mean over the bodies
    orientation: float  # rad, mean over the bodies
    anchor: float  # m
    height: float  # m, of the motion's anchor over the robot's
    tilt: float  # difference of the anchors' z axes along the world's
    ends: Array  # (E,) m, absolute differences in height of the end effectors


def errors_of(
    frame: Frame,
    ends: tuple[int, ...],
    *,
    joint_positions: Array,
    anchor: tuple[Array, Array],
    bodies: tuple[Array, Array],
) -> Errors:
    """Return how far a robot is from a frame of its motion.

    Args:
        frame: of the motion.
        ends: which of the bodies are end effectors.
        joint_positions: (J,) rad, of the robot.
        anchor: its position (3,) m and quaternion (4,).
        bodies: positions (B, 3) m and quaternions (B, 4).
    """
    place, quat = anchor
    off = product(quat, conjugate(frame.anchor_quat))
    half = heading(off) / 2.0
    turn = np.array([math.cos(half), 0.0, 0.0, math.sin(half)])
    origin = np.array([*place[:2].tolist(), float(frame.anchor_position[2])])
    positions = origin + turned(turn, frame.positions - frame.anchor_position)
    quats = product(turn, frame.quats)
    apart = bodies[0] - positions
    away = np.sqrt((apart**2).sum(axis=-1))
    angles = angle(product(quats, conjugate(bodies[1])))
    upright, wanted = (turned(one, _UP)[2] for one in (quat, frame.anchor_quat))
    missed = frame.anchor_position - place
    count = len(away)
    return Errors(
        joints=float(np.abs(joint_positions - frame.joint_positions).sum()) / len(joint_positions),
        position=float(away.sum()) / count,
        orientation=float(angles.sum()) / count,
        anchor=math.sqrt(float((missed**2).sum())),
        height=float(missed[2]),
        tilt=abs(float(upright - wanted)),
        ends=np.abs(apart[list(ends), 2]),
    )


_UP = np.array([0.0, 0.0, 1.0])


def product(one: Array, other: Array) -> Array:
    """Return the products of quaternions, (..., 4); leading axes broadcast."""
    a, b, c, d = (one[..., k] for k in range(4))
    w, x, y, z = (other[..., k] for k in range(4))
    return np.stack(
        [
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ],
        axis=-1,
    )


def conjugate(quat: Array) -> Array:
    """Return the inverses of unit quaternions, (..., 4)."""
    return quat * np.array([1.0, -1.0, -1.0, -1.0])


def turned(quat: Array, vectors: Array) -> Array:
    """Return vectors (..., 3) turned by unit quaternions (..., 4); leading axes broadcast."""
    zeros = np.zeros((*vectors.shape[:-1], 1))
    whole = np.concatenate([zeros, vectors], axis=-1)
    return product(product(quat, whole), conjugate(quat))[..., 1:]


def heading(quat: Array) -> float:
    """Return the yaw of a unit quaternion (4,), rad in (-pi, pi]."""
    w, x, y, z = quat.tolist()
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def angle(quat: Array) -> Array:
    """Return by how much unit quaternions (..., 4) turn, (...) rad in [0, pi]."""
    sine = np.sqrt((quat[..., 1:] ** 2).sum(axis=-1))
    return 2.0 * same_bits.arctan2(sine, np.abs(quat[..., 0]))


def columns_6d(quat: Array) -> list[float]:
    """Return the first two columns of a rotation matrix, row by row, (6,)."""
    w, x, y, z = quat.tolist()
    return [
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - w * z),
        2.0 * (x * y + w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
    ]
