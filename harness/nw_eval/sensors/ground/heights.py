"""Heights of the ground under a grid that goes along with the robot."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards.observations.heights import Axis, GridOrder
from nw_eval.scenes.rays import RayScene
from nw_eval.sensors.sensor import Moment

Array = NDArray[np.float64]
Rays = Callable[[], RayScene]
"""Gives the scene's static geometry, made when it is first asked for."""


def grid(x: Axis, y: Axis, order: GridOrder = "y_fastest") -> Array:
    """Return the points of a grid, (N, 2) m: x forward, y left, both ascending."""
    rows = np.meshgrid(
        np.linspace(*x), np.linspace(*y), indexing="ij" if order == "y_fastest" else "xy"
    )
    return np.stack(rows, axis=-1).reshape(-1, 2)


class HeightGrid:
    """Points around the trunk that turn with its yaw, and the ground under them.

    One ray goes straight down through each exact point.
    """

    def __init__(self, x: Axis, y: Axis, rays: Rays, order: GridOrder = "y_fastest") -> None:
        self._points = grid(x, y, order)
        # The points turned by a quarter: any other turn is a sum of the two.
        self._quarter = np.stack([-self._points[:, 1], self._points[:, 0]], axis=1)
        self._rays = rays

    def __len__(self) -> int:
        return len(self._points)

    def ground(self, moment: Moment) -> Array:
        """Return the heights, (N,) m in the world, -inf where there is no ground."""
        yaw = moment.roll_pitch_yaw[2]
        turned = math.cos(yaw) * self._points
        turned += math.sin(yaw) * self._quarter
        turned += moment.position[:2]
        return self._rays().height(turned)


def limited(values: Array, low: float, high: float) -> NDArray[np.float32]:
    """Return values within limits as float32; `np.clip` takes several times as long."""
    np.maximum(values, low, out=values)
    np.minimum(values, high, out=values)
    return values.astype(np.float32)
