"""Scandots: heights of the ground on a grid around the robot."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.policies.observations import ScandotsObservation
from nw_eval.scenes.rays import RayScene
from nw_eval.sensors.sensor import Moment


def grid(observation: ScandotsObservation) -> NDArray[np.float64]:
    """Return the points of the grid, (N, 2) m: x forward, y left, x-major, both ascending."""
    x, y = np.linspace(*observation.x), np.linspace(*observation.y)
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)


class Scandots:
    """clip(trunk_z + offset - ground_z) under points that turn with the robot's yaw, (N,) m.

    One ray goes straight down through each exact point. The published evaluation reads a rendered
    height image instead (`published_scandots`). Points with no ground under them read as far
    below.
    """

    unit = "m"
    is_image = False
    coverage = None

    def __init__(self, observation: ScandotsObservation, rays: RayScene) -> None:
        self._points = grid(observation)
        self._offset = observation.offset
        self._low, self._high = observation.clip
        self._rays = rays
        self.shape: tuple[int, ...] = (len(self._points),)
        self.dtype = np.dtype(np.float32)

    def reset(self) -> None:
        """Nothing to forget."""

    def measure(self, moment: Moment) -> NDArray[Any]:
        """Cast the rays."""
        yaw = moment.roll_pitch_yaw[2]
        c, s = math.cos(yaw), math.sin(yaw)
        x, y, z = moment.position.tolist()
        forward, left = self._points[:, 0], self._points[:, 1]
        points = np.empty_like(self._points)
        points[:, 0] = x + c * forward - s * left
        points[:, 1] = y + s * forward + c * left
        heights = z + self._offset - self._rays.height(points)
        return np.clip(heights, self._low, self._high).astype(np.float32)

    def memory(self) -> dict[str, NDArray[Any]]:
        """Nothing to remember."""
        return {}

    def remember(self, memory: dict[str, NDArray[Any]]) -> None:
        """Nothing to go back to."""
