"""What a click meets, and how high the ground is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nw_eval.scenes.mesh import TriangleMesh
from nw_eval.scenes.rays import RayScene
from nw_eval.twin.label.placement import Point, as_point


class Ground:
    """The mesh of a place, as rays meet it.

    Attributes:
        mesh: world, m.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        self.mesh = mesh
        self._rays = RayScene(mesh)

    def hit(self, origin: Point, direction: Point) -> Point | None:
        """Return where a ray meets the mesh first; None where it does not.

        Args:
            origin: world, m.
            direction: of any length but 0.
        """
        start = np.asarray(origin, dtype=np.float64)[None]
        along = np.asarray(direction, dtype=np.float64)[None]
        length = float(np.linalg.norm(along))
        if not np.isfinite(start).all() or not 0 < length < np.inf:
            return None
        along = along / length
        distance, face = self._rays.cast(start, along)
        if face[0] < 0:
            return None
        # Embree counts in float32; the face's own plane puts the point back on it.
        a, b, c = self.mesh.vertices[self.mesh.faces[face[0]]]
        normal = np.cross(b - a, c - a)
        slope = float(normal @ along[0])
        exact = float(normal @ (a - start[0])) / slope if slope else float(distance[0])
        near = abs(exact - distance[0]) < 1e-3 * (1 + distance[0])
        return as_point(start[0] + along[0] * (exact if near else float(distance[0])))

    def heights(self, xy: NDArray[np.float64], below: float) -> NDArray[np.float64]:
        """Return the ground's height (N,) under points xy (N, 2), m, -inf where there is none.

        Args:
            xy: world, m.
            below: height to look down from, so that ceilings and upper floors do not count.
        """
        return self._rays.height(xy, z_from=below)

    def dropped(self, x: float, y: float, near: float, *, clearance: float = 0.6) -> Point | None:
        """Return the point of the ground at x, y, seen from `clearance` above the height `near`."""
        height = float(self.heights(np.array([[x, y]]), near + clearance)[0])
        return (x, y, height) if np.isfinite(height) else None
