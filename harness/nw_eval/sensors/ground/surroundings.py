"""What a ray of a sensor meets first: the scene, a cone, or the robot itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nw_eval.sensors.drawing.cones import TrailCones
from nw_eval.sensors.drawing.palette import CONE, FACE_CLASSES, NOTHING, ROBOT
from nw_eval.sensors.ground.heights import Rays
from nw_eval.sensors.sensor import Moment

Array = NDArray[np.float64]


class Surroundings:
    """Geometry around a sensor that the robot carries.

    Embree answers for the static scene and for the cones, MuJoCo for the robot; the nearest
    answer counts.

    Args:
        rays: the scene's static geometry.
        cones: whether a cone stands on each waypoint.
        robot: whether the robot's body is there, but for the trunk, which carries the sensor.
    """

    def __init__(self, rays: Rays, *, cones: bool, robot: bool) -> None:
        self._rays = rays
        self._cones = TrailCones() if cones else None
        self._robot = robot

    def distance(self, moment: Moment, origin: Array, directions: Array) -> Array:
        """Return distances along rays, (N,) m, inf for a miss.

        Args:
            moment: where robot and cones stand.
            origin: (3,) of all rays, world, m.
            directions: (N, 3) unit vectors, world.
        """
        starts = np.broadcast_to(origin, directions.shape)
        distance = self._rays().distance(starts, directions)
        if self._cones is not None:
            cones = self._cones.on(moment.cones)
            distance = np.minimum(distance, cones.distance(origin, directions))
        if self._robot:
            hit = moment.world.ray_robot(origin, directions, exclude="trunk")
            distance = np.minimum(distance, hit.distance)
        return distance

    def classes(
        self, moment: Moment, origin: Array, directions: Array
    ) -> tuple[Array, NDArray[np.uint8]]:
        """Return distances as `distance` does, and what was met: indices into `CLASSES`, (N,)."""
        rays = self._rays()
        starts = np.broadcast_to(origin, directions.shape)
        distance, face = rays.cast(starts, directions)
        kinds = rays.mesh.kinds
        met = np.full(len(directions), NOTHING, dtype=np.uint8)
        seen = np.flatnonzero(face >= 0)
        met[seen] = FACE_CLASSES[kinds[face[seen]]]
        others: list[tuple[int, Array]] = []
        if self._cones is not None:
            cones = self._cones.on(moment.cones)
            others.append((CONE, cones.distance(origin, directions)))
        if self._robot:
            hit = moment.world.ray_robot(origin, directions, exclude="trunk")
            others.append((ROBOT, hit.distance))
        for number, other in others:
            nearer = other < distance
            met[nearer] = number
            distance = np.where(nearer, other, distance)
        return distance, met
