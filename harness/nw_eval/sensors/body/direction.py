"""The way to the next waypoint."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards.observations.direction import DirectionObservation
from nw_eval.sensors.measurement import Measurement
from nw_eval.sensors.sensor import Moment


class Direction(Measurement):
    """The angle from the heading to the next waypoint: (1,) rad, or (2,) sine and cosine."""

    def __init__(self, observation: DirectionObservation) -> None:
        self._as_angle = observation.values == "angle"
        self.unit = "rad" if self._as_angle else "1"
        self.shape: tuple[int, ...] = (1,) if self._as_angle else (2,)
        self.dtype = np.dtype(np.float32)

    def measure(self, moment: Moment) -> NDArray[Any]:
        """Read it."""
        angle = moment.delta_yaw
        values = [angle] if self._as_angle else [math.sin(angle), math.cos(angle)]
        return np.array(values, dtype=np.float32)
