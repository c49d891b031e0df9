"""Servo figures of the twelve joints, which a policy card may override."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Self

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from nw_eval.robots import RobotSpec

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Actuators:
    """Motors, one row a joint in robot order. All arrays are (12,) float64."""

    kp: Array  # N m / rad
    kd: Array  # N m s / rad; acts as joint damping, which MuJoCo integrates implicitly
    torque_limits: Array  # N m, symmetric
    armature: Array  # kg m^2
    friction_loss: Array  # N m
    strength: float = 1.0  # of gain and largest torque, the share that is left
    follow: Literal["position", "torque"] = "position"  # what they are told; torques ignore kp

    @classmethod
    def of(cls, robot: RobotSpec) -> Self:
        """Return the robot's own figures, the start of any override by `dataclasses.replace`."""
        count = len(robot.joints)
        return cls(
            kp=np.full(count, robot.kp),
            kd=np.full(count, robot.joint_damping),
            torque_limits=np.array(robot.torque_limits, dtype=np.float64),
            armature=np.full(count, robot.armature),
            friction_loss=np.full(count, robot.friction_loss),
        )
