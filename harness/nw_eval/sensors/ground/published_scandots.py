"""Scandots as the published evaluation reads them: from a height image seen 25 m above."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards.observations.heights import ScandotsObservation
from nw_eval.sensors.ground.heights import Rays, grid
from nw_eval.sensors.measurement import Measurement
from nw_eval.sensors.sensor import Moment

_ALTITUDE = 25.0  # m above the centre of mass, about
_PIXELS = 480  # along each side of the image
PIXELS_PER_METRE = _PIXELS / (2.0 * _ALTITUDE * math.tan(math.radians(3.0)))  # at 25 m

# How far the camera of a Go1 stands from 25 m above the trunk in the default stance. It is part of
# a card's `offset`, and here part of the camera's own height.
_STANCE = 0.0143


class PublishedScandots(Measurement):
    """The heights of `Scandots`, with the published camera, its pixels and its clipping.

    The camera follows the centre of mass. A point falls on the pixel that truncation toward zero
    gives it, and is read at that pixel's centre; points beyond the image (they are, when the robot
    walks diagonally) are read at its border. Ground lower than 25 m below the camera is seen a
    little farther out. Source: the published task, described in its section on scandots.
    """

    unit = "m"

    def __init__(
        self,
        observation: ScandotsObservation,
        rays: Rays,
        camera_offset: tuple[float, float, float],
    ) -> None:
        """Prepare the grid.

        Args:
            observation: from the card.
            rays: of the scene's static geometry.
            camera_offset: the camera minus the centre of mass, m.
        """
        self._points = grid(observation.x, observation.y, observation.order)
        self._offset = observation.offset - _STANCE
        self._low, self._high = observation.clip
        self._rays = rays
        self._camera_offset = np.array(camera_offset)
        self.shape: tuple[int, ...] = (len(self._points),)
        self.dtype = np.dtype(np.float32)

    def measure(self, moment: Moment) -> NDArray[Any]:
        """Read the image at the points."""
        camera = moment.world.center_of_mass + self._camera_offset
        at_altitude = (self._pixels(moment) - 0.5) / PIXELS_PER_METRE
        depth = np.full(len(at_altitude), _ALTITUDE)
        # A pixel's ray is nearly vertical: where it meets the ground settles at once.
        for _ in range(2):
            points = camera[:2] + at_altitude * (depth / _ALTITUDE)[:, np.newaxis]
            ground = self._rays().height(points)
            depth = camera[2] - ground
            depth[~np.isfinite(depth)] = 2.0 * _ALTITUDE  # The image's far plane.
        values = depth - _ALTITUDE + self._offset
        return np.clip(values, self._low, self._high).astype(np.float32)

    def _pixels(self, moment: Moment) -> NDArray[np.float64]:
        """Return the pixel of each point, counted from the middle of the image, (N, 2)."""
        # The published heading: the trunk's quaternion without its x and y parts.
        w, _, _, z = moment.world.trunk_quat.tolist()
        norm = math.hypot(w, z)
        c, s = (w * w - z * z) / norm**2, 2.0 * w * z / norm**2
        forward, left = self._points[:, 0], self._points[:, 1]
        turned = np.stack([c * forward - s * left, s * forward + c * left], axis=1)
        half = _PIXELS // 2
        return np.clip(np.trunc(turned * PIXELS_PER_METRE), 1 - half, half)
