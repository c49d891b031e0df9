"""The way to go, as one angle."""

from __future__ import annotations

from typing import Literal

from nw_eval.cards.observations.base import BaseObservation


class DirectionObservation(BaseObservation):
    """Angle from the heading to the next waypoint, rad in [-pi, pi), positive to the left."""

    sensor: Literal["direction"]
    values: Literal["angle", "sine_cosine"] = "angle"
    """`angle`: (1,). `sine_cosine`: (2,), without the jump behind the robot."""
