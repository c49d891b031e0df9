"""Laser scanners: points of the scene's geometry in the sensor's own frame."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards.observations.lidar import LidarObservation
from nw_eval.sensors.ground.heights import Rays
from nw_eval.sensors.ground.surroundings import Surroundings
from nw_eval.sensors.measurement import Measurement
from nw_eval.sensors.sensor import Moment
from nw_eval.sensors.wrappers.wrapper import Plain, Sample, Shot

Array = NDArray[np.float64]

_HALF_RECTANGLE = 0.6  # rad to each side, unless the card says otherwise


class Lidar(Measurement):
    """Distances along the rays, (channels, columns) float32 m, inf where there is no return.

    Points are made of them by `LidarForm`, so that noise acts along the rays.
    """

    unit = "m"
    nothing = math.inf

    def __init__(self, observation: LidarObservation, rays: Rays) -> None:
        self.shape: tuple[int, ...] = (observation.channels, observation.columns)
        self.dtype = np.dtype(np.float32)
        self.form = (LidarForm(observation),)
        mount = observation.mount
        self._position = np.array(mount.position)
        self._directions = pattern(observation).reshape(-1, 3) @ rotation(*mount.rpy).T
        self._around = Surroundings(rays, cones=observation.cones, robot=observation.robot)

    def measure(self, moment: Moment) -> NDArray[Any]:
        """Cast the rays."""
        origin = moment.position + moment.rotation @ self._position
        distance = self._around.distance(moment, origin, self._directions @ moment.rotation.T)
        return distance.astype(np.float32).reshape(self.shape)


class LidarForm(Plain):
    """Returns within range as points or ranges, and something for all others."""

    def __init__(self, observation: LidarObservation) -> None:
        self._range = (observation.min_range, observation.max_range)
        self._miss = np.nan if observation.miss == "nan" else observation.max_range
        self._in_points = observation.values == "points"
        self._pattern = pattern(observation).astype(np.float32)

    def __call__(self, sample: Sample, shot: Shot) -> Sample:  # noqa: ARG002 - as every wrapper.
        """Return (channels, columns, 3) or (channels, columns) float32."""
        nearest, farthest = self._range
        found = (sample >= nearest) & (sample <= farthest)
        ranges = np.where(found, sample, np.float32(self._miss))
        return self._pattern * ranges[..., np.newaxis] if self._in_points else ranges


def pattern(observation: LidarObservation) -> Array:
    """Return the unit directions of all rays in the sensor's frame, (channels, columns, 3)."""
    spins = observation.pattern == "spinning"
    low, high = observation.elevation
    if observation.azimuth is not None:
        right, left = observation.azimuth
        whole = left - right >= 2.0 * math.pi
    else:
        right, left = (-math.pi, math.pi) if spins else (-_HALF_RECTANGLE, _HALF_RECTANGLE)
        whole = spins
    rows, columns = observation.channels, observation.columns
    if spins:
        elevation = _spaced(low, high, rows)[:, np.newaxis]
        # A whole turn ends where it begins, so its last column is left out.
        azimuth = np.linspace(right, left, columns, endpoint=not whole)
        x, y = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
        return np.stack([x, y, np.broadcast_to(np.sin(elevation), x.shape)], axis=-1)
    left_right = _spaced(math.tan(right), math.tan(left), columns)
    up = _spaced(math.tan(low), math.tan(high), rows)[:, np.newaxis]
    ahead = np.ones((rows, columns))
    directions = np.stack([ahead, ahead * left_right, ahead * up], axis=-1)
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)


def rotation(roll: float, pitch: float, yaw: float) -> Array:
    """Return R_trunk_sensor (3, 3) = Rz(yaw) Ry(pitch) Rx(roll); angles in rad."""
    cr, sr = math.cos(roll), math.sin(roll)
    cp, sp = math.cos(pitch), math.sin(pitch)
    cy, sy = math.cos(yaw), math.sin(yaw)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def _spaced(first: float, last: float, count: int) -> Array:
    """Return equally spaced numbers; a single one stands in the middle."""
    return np.linspace(first, last, count) if count > 1 else np.array([0.5 * (first + last)])
