"""Edges that hang over: a rim of centimetres stands on what it is the rim of.

Photographs are taken from above, and none shows what is below a rim. There a mesh closes as it
likes, mostly askew and under the edge: a platform gets a lip, thin and with air below, that a foot
would find to be a plank of its own. A lip as narrow as an edge is uncertain is taken for the edge.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nw_eval.scenes.mesh import FACE_KINDS, TriangleMesh
from nw_eval.scenes.rays import RayScene

F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]

_DOWN = -0.02
"""Upward part of the normal of a face below which it looks down."""
_THICK = 0.15
"""Of a lip at most, metres: what is higher is a wall that leans, or a bridge."""
_REACH = (0.03, 0.06, 0.09)
"""Metres within which a lip must meet what it is the rim of."""
_LEVEL = 0.03
"""Difference in height of a lip and that, metres."""
_BELOW = 2e-4
"""From a surface on which a ray goes on, metres."""
_WAYS = 8


def without_lips(vertices: F64, faces: NDArray[np.integer]) -> NDArray[np.integer]:
    """Return the faces without the undersides of lips; without one, what is below is solid.

    Args:
        vertices: (V, 3) world, m, z up.
        faces: (F, 3), counter-clockwise from outside.
    """
    kinds = np.full(len(faces), FACE_KINDS.index("ground"), np.uint8)
    mesh = TriangleMesh(vertices=vertices, faces=faces.astype(np.int32), kinds=kinds)
    corners = mesh.triangles
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    up = normal[:, 2] / np.maximum(np.linalg.norm(normal, axis=1), 1e-300)
    rays = RayScene(mesh)
    rows = np.flatnonzero(up < _DOWN)
    middles = corners[rows].mean(axis=1)
    above, face = _cast(rays, middles, 1.0)
    thin = (above < _THICK) & (up[face] > 0.0)
    rows, tops = rows[thin], middles[thin] + above[thin, None] * (0.0, 0.0, 1.0)
    lip = np.zeros(len(rows), dtype=bool)
    for reach in _REACH:
        for turn in 2.0 * np.pi * np.arange(_WAYS) / _WAYS:
            lip |= _solid(rays, up, tops + reach * np.array([np.cos(turn), np.sin(turn), 0.0]))
    kept = np.ones(len(faces), dtype=bool)
    kept[rows[lip]] = False
    return faces[kept]


def _solid(rays: RayScene, up: F64, places: F64) -> Mask:
    """Return at which places (N, 3) ground is about as high, and thicker than a lip.

    Args:
        rays: of the mesh.
        up: (F,) upward part of the normals of its faces.
        places: metres.
    """
    start = places + np.array([0.0, 0.0, _LEVEL])
    depth, face = _cast(rays, start, -1.0)
    there = (depth < 2.0 * _LEVEL) & (up[face] > 0.0)
    top = start - np.minimum(depth, 1.0)[:, None] * (0.0, 0.0, 1.0)
    thick, below = _cast(rays, top, -1.0)
    return there & ((up[below] > 0.0) | (thick >= _THICK))


def _cast(rays: RayScene, places: F64, way: float) -> tuple[F64, NDArray[np.int32]]:
    """Return the distance of the next face straight up or down, and which it is, -1 for none."""
    step = np.array([0.0, 0.0, way])
    distance, face = rays.cast(places + _BELOW * step, np.broadcast_to(step, places.shape))
    return distance + _BELOW, face
