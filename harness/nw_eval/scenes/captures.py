"""Where a place was photographed from: near those cameras its splat shows it, far away fog."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PER_RADIAN = 6.0 / pi
"""Metres that a turn of one radian counts as: 30 degrees are as far as one metre. A photograph
taken a step aside shows much of what one from here does, and one that looks elsewhere, little."""


class Nearness(NamedTuple):
    """How far a camera is from the nearest of those that a place was photographed with."""

    distance: float  # m
    angle: float  # between the optical axes, rad, 0 to pi


@dataclass(frozen=True, kw_only=True, eq=False)
class CaptureCameras:
    """The cameras that a place was photographed with.

    Attributes:
        positions: (N, 3) float64, metres, world; at least one.
        axes: (N, 3) float64, unit vectors along which they looked, world.
    """

    positions: Array
    axes: Array

    def __post_init__(self) -> None:
        """Check the arrays.

        Raises:
            ValueError: their shapes do not fit, or there is no camera.
        """
        shapes = self.positions.shape, self.axes.shape
        count = len(self.positions)
        if count == 0 or shapes != ((count, 3), (count, 3)):
            raise ValueError(f"positions and axes of capture cameras have the shapes {shapes}")

    @cached_property
    def _columns(self) -> tuple[Array, Array]:
        """Positions and axes as (3, N), each component in one piece."""
        return np.ascontiguousarray(self.positions.T), np.ascontiguousarray(self.axes.T)

    def nearest(self, T_world_camera: Array) -> Nearness:
        """Return how far the nearest camera is: the one with the least of metres and turn together.

        That is distance + `PER_RADIAN` * angle; distance and angle are both of that one.

        Args:
            T_world_camera: (4, 4) pose of a camera that looks along its own z.
        """
        # Component by component: it is asked for each image, and a BLAS call may round otherwise on
        # another CPU.
        (x, y, z), (a, b, c) = self._columns
        (u, v, w), (px, py, pz) = T_world_camera[:3, 2].tolist(), T_world_camera[:3, 3].tolist()
        distances = np.sqrt((x - px) ** 2 + (y - py) ** 2 + (z - pz) ** 2)
        angles = np.arccos(np.minimum(np.maximum(a * u + b * v + c * w, -1.0), 1.0))
        place = int(np.argmin(distances + PER_RADIAN * angles))
        return Nearness(float(distances[place]), float(angles[place]))
