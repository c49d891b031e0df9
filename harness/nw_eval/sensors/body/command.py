"""Velocity commands: what a card's `command` asks of the policy at a moment."""

from __future__ import annotations

import math
from typing import assert_never

from nw_eval.cards.command import Command, ConstantCommand, TrailFollower, WaypointCommand
from nw_eval.sensors.sensor import Moment


def velocity_command(command: Command, moment: Moment) -> tuple[float, float, float]:
    """Return vx, vy (m/s, yaw frame) and yaw rate (rad/s)."""
    return velocity_at(command, moment.delta_yaw)


def velocity_at(command: Command, error: float) -> tuple[float, float, float]:
    """Return the same for a heading error: the angle to the next waypoint, rad to the left."""
    match command:
        case ConstantCommand():
            return command.velocity
        case TrailFollower():
            forward = max(0.0, math.cos(error)) if command.slow_in_turns else 1.0
            turn = command.yaw_gain * error
            limit = command.yaw_limit
            return command.speed * forward, 0.0, min(max(turn, -limit), limit)
        case WaypointCommand():
            return command.speed, 0.0, 0.0
        case _:
            assert_never(command)


def commanded_speed(command: Command) -> float:
    """Return the forward speed that a command asks for on a straight trail, m/s."""
    return command.velocity[0] if isinstance(command, ConstantCommand) else command.speed
