"""The motors of a trial that are more than servos: the card's groups, and their networks."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from nw_base.errors import StoreError
from nw_base.memory import pack, unpack
from nw_policies.cards import motor_groups
from nw_policies.cards.motors import NetworkMotor
from nw_policies.executor import Program
from nw_policies.motor_network import INPUT, motor_program
from nw_sim.physics.motors import Drive

if TYPE_CHECKING:
    from nw_policies import Bundle
    from nw_policies.cards import Card
    from nw_scenes.robots import RobotSpec
    from nw_sim.physics import Actuators

Programs = Callable[[int, int, int], Program]
"""Gives the network of a group: which of those with one, how many joints, numbers for each."""

_program = lru_cache(maxsize=8)(motor_program)  # All trials of a process have the same motors.


def programs_of(bundle: Bundle) -> Programs:
    """Return what reads a bundle's networks of motors; it raises PolicyError as `motor_program`."""

    def program(number: int, joints: int, inputs: int) -> Program:
        where = str(bundle.motors[number].path)
        return _program(bundle.read_motor(number), where, joints=joints, inputs=inputs)

    return program


def driven(actuators: Actuators, card: Card, robot: RobotSpec, programs: Programs) -> Actuators:
    """Return motors with the groups of a card.

    Args:
        actuators: gains and limits of all joints.
        card: of the policy, as the trial has it.
        robot: that it drives.
        programs: give the networks.

    Raises:
        PolicyError: a group does not fit the robot, or its network cannot be used.
    """
    drives = tuple(drives_of(card, robot, programs))
    return replace(actuators, drives=drives) if drives else actuators


def drives_of(card: Card, robot: RobotSpec, programs: Programs) -> Iterator[Drive]:
    """Give the groups of motors of a card, each with its network; it raises as `driven`."""
    networks = 0
    for motor, joints in motor_groups(card, robot):
        program = None
        if isinstance(motor, NetworkMotor):
            program = programs(networks, len(joints), 2 * len(motor.history))
            networks += 1
        yield Drive(motor=motor, joints=joints, program=program)


def packed_programs(drives: Sequence[Drive]) -> bytes:
    """Return the networks of groups as bytes, for the log of a trial; empty if there are none."""
    programs = [drive.program.packed() for drive in drives if drive.program is not None]
    arrays = {str(n): np.frombuffer(one, np.uint8) for n, one in enumerate(programs)}
    return pack(arrays) if arrays else b""


def unpacked_programs(data: bytes, where: str) -> Programs:
    """Return what gives networks of `packed_programs`, whoever wrote the bytes.

    It raises StoreError where they are damaged, or of other motors.
    """

    def program(number: int, joints: int, inputs: int) -> Program:
        try:
            found = Program.unpacked(unpack(data)[str(number)].tobytes())
            if found.inputs[INPUT].shape == (joints, inputs):
                return found
        except (KeyError, ValueError, TypeError, AttributeError):
            pass
        raise StoreError(
            f"{where}: it holds no network of the motors of its card",
            fix="replay a log that is whole",
        ) from None

    return program
