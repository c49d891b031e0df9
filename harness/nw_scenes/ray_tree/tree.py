"""A mesh that rays can be cast against: a tree of boxes, and the kernels that search it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nw_scenes.ray_tree.kernels import LEAF, NODE, ROOT, build, cast


class Tree:
    """Triangles in a tree of boxes.

    Coordinates are rounded to float32. Both sides of a triangle are hit, edges and corners too; a
    triangle with a corner that is not finite never is, and a ray of such numbers hits nothing. Of
    triangles at equal distance the first counts.

    Args:
        vertices: (V, 3) metres.
        faces: (F, 3) indices of vertices.
    """

    def __init__(self, vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> None:
        corners = np.ascontiguousarray(vertices, dtype=np.float32)
        faces = np.ascontiguousarray(faces, dtype=np.int32)
        # Untouched pages of this take no memory.
        room = np.empty(ROOT + (len(faces) + 1) * (NODE + LEAF), np.int32)
        boxes, order = np.empty((len(faces), 6), np.float32), np.empty(len(faces), np.int32)
        words = build(corners, faces, boxes, order, room, room.view(np.float32))
        self._tree = room[:words].copy()

    def cast(
        self, origins: NDArray[np.floating], directions: NDArray[np.floating]
    ) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
        """Return the first face along each ray.

        Args:
            origins: (N, 3) metres; or (3,), one for all.
            directions: (N, 3), of any length.

        Returns:
            distance (N,) float64 in lengths of the direction, inf for a miss; face (N,) int32, -1
            for a miss.
        """
        along = np.ascontiguousarray(directions, dtype=np.float32)
        begin = np.ascontiguousarray(origins, dtype=np.float32)
        if along.shape[1:] != (3,) or begin.shape not in {(3,), along.shape}:
            raise ValueError(f"origins {begin.shape} and directions {along.shape} are not rays")
        distance, face = np.empty(len(along)), np.empty(len(along), np.int32)
        step = 3 if begin.ndim > 1 else 0
        cast(self._tree, begin.reshape(-1), step, along.reshape(-1), distance, face)
        return distance, face

    def distance(
        self, origins: NDArray[np.floating], directions: NDArray[np.floating]
    ) -> NDArray[np.float64]:
        """Return only the distances of `cast`."""
        return self.cast(origins, directions)[0]

    def face(
        self, origins: NDArray[np.floating], directions: NDArray[np.floating]
    ) -> NDArray[np.int32]:
        """Return only the faces of `cast`."""
        return self.cast(origins, directions)[1]
