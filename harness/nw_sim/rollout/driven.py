"""The motors of a trial that are more than servos: the card's groups, and their networks."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

from nw_policies.cards import motor_groups
from nw_policies.cards.motors import NetworkMotor
from nw_policies.motor_network import motor_program
from nw_sim.physics.motors import Drive

if TYPE_CHECKING:
    from nw_policies import Bundle
    from nw_policies.cards import Card
    from nw_scenes.robots import RobotSpec
    from nw_sim.physics import Actuators

_program = lru_cache(maxsize=8)(motor_program)  # All trials of a process have the same motors.


def driven(actuators: Actuators, card: Card, robot: RobotSpec, bundle: Bundle) -> Actuators:
    """Return motors with the groups of a card.

    Args:
        actuators: gains and limits of all joints.
        card: of the policy, as the trial has it.
        robot: that it drives.
        bundle: with the files of networks.

    Raises:
        PolicyError: a group does not fit the robot, or its network cannot be used.
    """
    drives: list[Drive] = []
    files = 0
    for motor, joints in motor_groups(card, robot):
        program = None
        if isinstance(motor, NetworkMotor):
            program = _program(
                bundle.read_motor(files),
                str(bundle.motors[files].path),
                joints=len(joints),
                inputs=2 * len(motor.history),
            )
            files += 1
        drives.append(Drive(motor=motor, joints=joints, program=program))
    return replace(actuators, drives=tuple(drives)) if drives else actuators
