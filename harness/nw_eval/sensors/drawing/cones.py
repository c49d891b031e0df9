"""Traffic cones at the waypoints: what the published evaluation paints into camera images."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from nw_eval.scenes.mesh import CONE_BASE, CONE_HEIGHT, TriangleMesh, cone_mesh, merge
from nw_eval.scenes.rays import RayScene

# Share of the light that reaches a face from everywhere; the rest comes from above.
_AMBIENT = 0.5
_BOUND = 1.05 * math.hypot(CONE_BASE / math.sqrt(2.0), CONE_HEIGHT / 2)
"""Radius of a sphere around a cone's middle that holds all of it, m."""


class Cones:
    """Cones on a course, answered by ray casting. Nothing ever touches them."""

    def __init__(self, waypoints: NDArray[np.float64]) -> None:
        """Put a cone on each waypoint, (K, 3) m."""
        cone = cone_mesh()
        self._rays = RayScene(
            merge(
                [
                    TriangleMesh(
                        vertices=cone.mesh.vertices + waypoint,
                        faces=cone.mesh.faces,
                        kinds=cone.mesh.kinds,
                    )
                    for waypoint in waypoints
                ]
            )
        )
        self._middles = waypoints + np.array([0.0, 0.0, CONE_HEIGHT / 2])
        corners = cone.mesh.triangles
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(normal, axis=1)
        upwards = normal[:, 2] / np.where(length > 0.0, length, 1.0)  # The tip has no area.
        light = shade(upwards).astype(np.float32)
        self._colour = np.tile(cone.colors * light[:, np.newaxis], (len(waypoints), 1))

    def cast(
        self, origin: NDArray[np.float64], directions: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """Return distance (N,) m, inf for a miss, and colour (N, 3) along rays from one point."""
        near = self._near(origin, directions)
        distance = np.full(len(directions), np.inf)
        colour = np.zeros((len(directions), 3), dtype=np.float32)
        rays = directions[near]
        distance[near], face = self._rays.cast(origin, rays)
        colour[near] = self._colour[face]
        return distance, colour

    def distance(
        self, origin: NDArray[np.float64], directions: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return only the distances of `cast`."""
        near = self._near(origin, directions)
        distance = np.full(len(directions), np.inf)
        rays = directions[near]
        distance[near] = self._rays.distance(origin, rays)
        return distance

    def _near(
        self, origin: NDArray[np.float64], directions: NDArray[np.float64]
    ) -> NDArray[np.intp]:
        """Return which rays come as near to a cone as its bounding sphere: few of a picture's."""
        way = self._middles - origin
        apart = np.linalg.norm(way, axis=1)
        # Within the sphere of one, every ray is.
        least = np.sqrt(np.maximum(1.0 - (_BOUND / apart) ** 2, 0.0))
        least[apart <= _BOUND] = -np.inf
        # A row for each cone: along it NumPy compares many times as fast as across it.
        towards = (way / apart[:, np.newaxis]) @ directions.T
        return np.flatnonzero((towards > least[:, np.newaxis]).any(axis=0))


def shade(upwards: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how bright surfaces are whose unit normals have these z components, 0.5 to 1."""
    return _AMBIENT + (1.0 - _AMBIENT) * (0.5 + 0.5 * upwards)


class CourseCones:
    """The cones of a course that may be another one in the next trial."""

    def __init__(self) -> None:
        self._cones: Cones | None = None
        self._trail: NDArray[np.float64] | None = None

    def on(self, trail: NDArray[np.float64]) -> Cones:
        """Return cones on waypoints (K, 3), made once for each array of them."""
        if self._cones is None or self._trail is not trail:
            self._cones, self._trail = Cones(trail), trail
        return self._cones
