"""Rays against static geometry, the same on every processor."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from nw_scenes.mesh import FACE_KINDS, TriangleMesh
from nw_scenes.ray_tree.tree import Tree

_LOOKED_THROUGH = [FACE_KINDS.index(kind) for kind in ("overhead", "beside")]


class RayScene:
    """A mesh that rays can be cast against. One instance serves one process.

    Both sides of a face are hit. Origins and directions are rounded to float32 on the way in, so
    distances are exact to about 1e-6 of the scene's size.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        self.mesh = mesh
        corners = mesh.triangles
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self._scene = Tree(mesh.vertices, mesh.faces)
        # Heights are asked of ground that one can stand on: a ceiling shows its underside, and
        # crowns and lamps hang overhead.
        walkable = (normal[:, 2] > 0) & ~np.isin(mesh.kinds, _LOOKED_THROUGH)
        faces = np.flatnonzero(walkable)
        self._ground = Tree(mesh.vertices, mesh.faces[faces])
        # Corner and normal of each of them, a column for each face. The last one is that of a miss,
        # which has index -1: infinitely deep.
        planes = np.concatenate([corners[faces, 0], normal[faces]], axis=1)
        nowhere = [[0.0, 0.0, -np.inf, 0.0, 0.0, 1.0]]
        self._planes = np.ascontiguousarray(np.concatenate([planes, nowhere]).T)

    def cast(
        self, origins: NDArray[np.floating], directions: NDArray[np.floating]
    ) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
        """Return the first face along each ray.

        Args:
            origins: (N, 3) metres, world; or (3,), one for all.
            directions: (N, 3) unit vectors, world.

        Returns:
            distance (N,) float64 metres, inf for a miss; face (N,) int32, -1 for a miss.
        """
        if len(directions) == 0:
            return np.zeros(0), np.zeros(0, dtype=np.int32)
        return self._scene.cast(origins, directions)

    def distance(
        self, origins: NDArray[np.floating], directions: NDArray[np.floating]
    ) -> NDArray[np.float64]:
        """Return only the distances of `cast`, (N,) metres, inf for a miss; a little faster."""
        if len(directions) == 0:
            return np.zeros(0)
        return self._scene.distance(origins, directions)

    def height(
        self, xy: NDArray[np.floating], z_from: float | NDArray[np.float64] = 50.0
    ) -> NDArray[np.float64]:
        """Return the height of the ground under points: the first upward face below `z_from`.

        Undersides (ceilings, shelves from below) and faces `overhead` or `beside` do not count.

        Args:
            xy: (N, 2) metres, world.
            z_from: height to look down from, metres; one for all, or (N,).

        Returns:
            (N,) float64 metres, -inf where there is nothing below.
        """
        count = len(xy)
        if count == 0 or self._planes.shape[1] == 1:
            return np.full(count, -np.inf)
        origins = np.empty((count, 3), dtype=np.float32)
        origins[:, :2] = xy
        origins[:, 2] = z_from
        hit = self._ground.face(origins, _down(count))
        # The plane's own equation in float64: 50 m of float32 distance would cost micrometres.
        x, y, z, nx, ny, nz = self._planes.take(hit, axis=1)
        rise = (xy[:, 0] - x) * nx
        rise += (xy[:, 1] - y) * ny
        rise /= nz
        return z - rise


@lru_cache(maxsize=8)
def _down(count: int) -> NDArray[np.float32]:
    """Return directions straight down, (N, 3), which must not be changed."""
    return np.tile(np.array([0.0, 0.0, -1.0], dtype=np.float32), (count, 1))
