"""Laser scanners."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from nw_eval.cards.model import CardModel, Limits
from nw_eval.cards.observations.base import BaseObservation


class Mount(CardModel):
    """Where a sensor sits on the trunk."""

    position: tuple[float, float, float] = (0.2, 0.0, 0.12)
    """Trunk frame, m."""
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Roll, pitch and yaw of the sensor's frame in the trunk's, rad; level = (0, 0, 0)."""


class LidarObservation(BaseObservation):
    """A laser scanner: points in the sensor's frame (x ahead, y left, z up), float32 m.

    All rays of a sample leave at one instant: a scan is not bent by the robot's motion.
    Points are (channels, columns, 3): channels from the lowest up, columns from right to left.
    """

    sensor: Literal["lidar"]
    pattern: Literal["spinning", "solid_state"] = "spinning"
    """`spinning`: channels at equal steps of elevation, columns at equal steps of azimuth around
    the whole circle, beginning behind the sensor. `solid_state`: a rectangle, equally spaced in
    the plane ahead, as flash sensors have it."""
    channels: int = Field(default=16, ge=1, le=512)
    """Rays above one another."""
    columns: int = Field(default=1800, ge=1, le=4096)
    """Rays beside one another."""
    elevation: Limits = (-0.2618, 0.2618)
    """Lowest and highest channel, rad."""
    azimuth: Limits | None = None
    """Rightmost and leftmost column, rad; null = the whole circle, or -0.6 to 0.6 of a rectangle.
    """
    mount: Mount = Mount()
    """Where it sits on the trunk."""
    min_range: float = Field(default=0.1, ge=0.0)
    """Nearer surfaces give no point, m."""
    max_range: float = Field(default=30.0, gt=0.0)
    """Farther ones neither, m."""
    values: Literal["points", "ranges"] = "points"
    """`ranges`: (channels, columns), the distances along the rays."""
    miss: Literal["nan", "max_range"] = "nan"
    """What a ray gives that meets nothing within range: NaN, or a point at `max_range`."""
    cones: bool = False
    """Whether a traffic cone stands on each waypoint."""
    robot: bool = False
    """Whether the robot's own legs are seen; never the trunk that carries the sensor."""
