"""Scandots: heights of the ground on a grid around the robot, as a row of numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards.observations.heights import ScandotsObservation
from nw_eval.sensors.ground.heights import HeightGrid, Rays, limited
from nw_eval.sensors.measurement import Measurement
from nw_eval.sensors.sensor import Moment


class Scandots(Measurement):
    """clip(trunk_z + offset - ground_z) under the points of the grid, (N,) m.

    A view of the same grid as `Heightmap`, counted downwards. The published evaluation reads a
    rendered height image instead (`published_scandots`). Points with no ground under them read as
    far below.
    """

    unit = "m"

    def __init__(self, observation: ScandotsObservation, rays: Rays) -> None:
        self._grid = HeightGrid(observation.x, observation.y, rays, observation.order)
        self._offset = observation.offset
        self._low, self._high = observation.clip
        self.shape: tuple[int, ...] = (len(self._grid),)
        self.sum_of = f"{observation.x[2]} x {observation.y[2]}"
        self.dtype = np.dtype(np.float32)

    def measure(self, moment: Moment) -> NDArray[Any]:
        """Cast the rays."""
        top = float(moment.position[2]) + self._offset
        return limited(top - self._grid.ground(moment), self._low, self._high)
