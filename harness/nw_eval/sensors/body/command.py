"""Velocity commands: what a card's `command` asks of the policy at a moment."""

from __future__ import annotations

import math

from nw_eval.cards.command import Command, ConstantCommand
from nw_eval.sensors.sensor import Moment


def velocity_command(command: Command, moment: Moment) -> tuple[float, float, float]:
    """Return vx, vy (m/s, yaw frame) and yaw rate (rad/s)."""
    return velocity_at(command, moment.delta_yaw)


def velocity_at(command: Command, error: float) -> tuple[float, float, float]:
    """Return the same for a heading error: the angle to the next waypoint, rad to the left."""
    if command.source == "constant":
        return command.velocity
    if command.source == "waypoint":
        return command.speed, 0.0, 0.0
    forward = max(0.0, math.cos(error)) if command.slow_in_turns else 1.0
    turn, limit = command.yaw_gain * error, command.yaw_limit
    return command.speed * forward, 0.0, min(max(turn, -limit), limit)


def commanded_speed(command: Command) -> float:
    """Return the forward speed that a command asks for on a straight trail, m/s."""
    return command.velocity[0] if isinstance(command, ConstantCommand) else command.speed
