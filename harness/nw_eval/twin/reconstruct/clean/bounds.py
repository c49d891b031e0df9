"""Planes that bound a place: nothing lies behind them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nw_eval.twin.reconstruct.clean.flatten import FlatPlane
from nw_eval.twin.reconstruct.mesh_file import ColourMesh
from nw_eval.twin.reconstruct.packages import package

_BEHIND = 2.0
"""Bands from a plane, on the side that nobody sees, from which on a vertex lies behind it."""
_MOST = 0.02
"""Share of the vertices that may: what is far off and wrong."""


def behind(mesh: ColourMesh, plane: FlatPlane, band: float) -> NDArray[np.bool_]:
    """Return which vertices (V,) lie behind a plane by more than some of its bands."""
    return mesh.vertices @ np.array(plane.normal) - plane.offset < -_BEHIND * band


def bounds(mesh: ColourMesh, plane: FlatPlane, band: float) -> bool:
    """Return whether a mesh lies before a plane, but for what is wrong."""
    return bool(behind(mesh, plane, band).mean() <= _MOST)


def in_hull(cells: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the cells (H, W) within the convex hull of some; none if those lie on a line."""
    spatial = package("scipy.spatial")
    places = np.argwhere(cells)
    if len(places) < 3 or (np.ptp(places, axis=0) == 0).any():
        return np.zeros_like(cells)
    try:
        hull = spatial.ConvexHull(places)
    except spatial.QhullError:
        return np.zeros_like(cells)
    rows, columns = np.indices(cells.shape)
    found = np.ones(cells.shape, dtype=bool)
    for down, right, offset in hull.equations:
        found &= down * rows + right * columns + offset <= 1e-9
    return found
