"""The motors of a card, with the robot's own figures where it says nothing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards import Card, JointControl, actuator_values
from nw_eval.cards.joints import short_name
from nw_eval.robots import RobotSpec


def motor_values(card: Card, robot: RobotSpec) -> dict[str, NDArray[np.float64]]:
    """Return kp, kd, torque_limits, armature and friction_loss: (12,) each, in the robot's order.

    Raises:
        PolicyError: they do not fit the robot.
    """
    count = len(robot.joints)
    return actuator_values(card, robot) or {
        "kp": np.full(count, robot.kp),
        "kd": np.full(count, robot.joint_damping),
        "torque_limits": np.array(robot.torque_limits),
        "armature": np.full(count, robot.armature),
        "friction_loss": np.full(count, robot.friction_loss),
    }


def joint_names(card: Card, robot: RobotSpec) -> list[str]:
    """Return the short names of the joints in the policy's order."""
    return [short_name(robot.joints[i]) for i in JointControl.from_card(card, robot).order]
