"""What a policy is told to do."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from nw_eval.cards.model import CardModel


class WaypointCommand(CardModel):
    """The policy finds its own way to the next waypoint (`delta_yaw`) at a speed."""

    source: Literal["waypoint"] = "waypoint"
    speed: float = Field(default=0.8, ge=0.0, le=5.0)
    """What the term `speed` reads, m/s."""


class TrailFollower(CardModel):
    """A velocity command that steers towards the next waypoint.

    vx = speed * max(0, cos(delta_yaw)), vy = 0, yaw rate = clip(yaw_gain * delta_yaw).
    """

    source: Literal["trail_follower"]
    speed: float = Field(default=0.8, ge=0.0, le=5.0)
    """m/s."""
    yaw_gain: float = Field(default=1.5, ge=0.0)
    """Yaw rate for each radian off course, 1/s."""
    yaw_limit: float = Field(default=1.0, gt=0.0)
    """Largest yaw rate, rad/s."""
    slow_in_turns: bool = True
    """False: vx = speed always."""


class ConstantCommand(CardModel):
    """The same velocity command at all times."""

    source: Literal["constant"]
    velocity: tuple[float, float, float]
    """vx, vy (m/s), yaw rate (rad/s)."""


Command = Annotated[
    WaypointCommand | TrailFollower | ConstantCommand, Field(discriminator="source")
]
