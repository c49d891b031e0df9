"""A map of the ground around the robot."""

from __future__ import annotations

from typing import Any, assert_never

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards.observations.heights import HeightmapObservation
from nw_eval.sensors.ground.heights import HeightGrid, Rays, limited
from nw_eval.sensors.measurement import Measurement
from nw_eval.sensors.sensor import Moment


class Heightmap(Measurement):
    """Ground heights above a reference, (x, y) float32 m, in a frame that turns with the yaw."""

    unit = "m"

    def __init__(self, observation: HeightmapObservation, rays: Rays) -> None:
        self._grid = HeightGrid(observation.x, observation.y, rays)
        self._observation = observation
        self._low, self._high = observation.clip
        self._rays = rays
        self.shape: tuple[int, ...] = (observation.x[2], observation.y[2])
        self.dtype = np.dtype(np.float32)

    def measure(self, moment: Moment) -> NDArray[Any]:
        """Cast the rays."""
        heights = self._grid.ground(moment) - self._reference(moment)
        return limited(heights, self._low, self._high).reshape(self.shape)

    def _reference(self, moment: Moment) -> float:
        match self._observation.relative_to:
            case "trunk":
                return float(moment.position[2])
            case "world":
                return 0.0
            case "ground":
                below = float(self._rays().height(moment.position[np.newaxis, :2])[0])
                # Over a hole in the scan, the plane that everything stands on serves.
                return below if np.isfinite(below) else moment.world.scene.ground.z
            case _:
                assert_never(self._observation.relative_to)
