"""Upright sheets that rays from above slip past: scanned walls, thin panels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nw_eval.scenes.mesh import TriangleMesh
from nw_eval.scenes.terrain.grid import Grid, shifted
from nw_eval.scenes.terrain.surface import Columns, Surface

Values = NDArray[np.float64]
Mask = NDArray[np.bool_]

# |n_z| of a face that counts as upright.
_UPRIGHT = 0.35
# How far above the ground a sheet may begin and still stand on it, metres.
_FOOT = 0.15
_LEAST = 0.03


def raise_walls(
    heights: Values, columns: Columns, mesh: TriangleMesh, surface: Surface, grid: Grid
) -> tuple[Values, Mask]:
    """Raise samples to the top of upright sheets that stand on the ground there.

    Args:
        heights: (R, C) metres, nan where there is nothing.
        columns: what lies above the same samples.
        mesh: whose upright faces are looked at.
        surface: of that mesh.
        grid: of the samples.

    Returns:
        Heights and which of them were raised, (R, C) each.
    """
    raised = np.zeros(grid.shape, dtype=np.bool_)
    points, foot = _edge_points(mesh, grid)
    ceiling = surface.ceiling(points[:, :2])
    index, inside = grid.nearest(points[:, :2])
    # A face that begins above the ceiling hangs there; another is cut off at it.
    inside &= foot < ceiling
    index, z = index[inside], np.minimum(points[:, 2], ceiling)[inside]
    low = np.full(grid.rows * grid.columns, np.inf)
    high = np.full(grid.rows * grid.columns, -np.inf)
    np.minimum.at(low, index, z)
    np.maximum.at(high, index, z)
    # What is there already: ground, or a slab above it.
    known = np.where(np.isnan(heights), -np.inf, heights).ravel()
    tops = known.copy()
    np.maximum.at(tops, columns.slab_of, columns.slab_top)
    floor, top = (
        np.maximum(shifted(part.reshape(grid.shape), -np.inf).max(axis=0).ravel(), part)
        for part in (known, tops)
    )
    stands = (high > top + _LEAST) & (low < floor + _FOOT) & (high > -np.inf)
    raised.ravel()[stands] = True
    lifted = heights.copy()
    lifted.ravel()[stands] = high[stands]
    return lifted, raised


def _edge_points(mesh: TriangleMesh, grid: Grid) -> tuple[Values, Values]:
    """Return points (N, 3) on the edges of upright faces over the grid, half a step apart.

    With them comes where the face of each begins, (N,) metres, world z.

    Seen from above an upright triangle is a line, and its edges cover that line and reach as high
    as the triangle does.
    """
    corners = mesh.triangles
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1)
    x, y = grid.half_size
    low = np.array([grid.x0, grid.y0])
    high = low + np.array([2 * x, 2 * y])
    chosen = (
        (np.abs(normal[:, 2]) < _UPRIGHT * length)
        & (corners[:, :, :2].max(axis=1) >= low).all(axis=1)
        & (corners[:, :, :2].min(axis=1) <= high).all(axis=1)
    )
    faces = corners[chosen]
    starts = faces.reshape(-1, 3)
    foot = np.repeat(faces[:, :, 2].min(axis=1), 3)
    along = np.roll(faces, -1, axis=1).reshape(-1, 3) - starts
    # Only the stretch of an edge that lies over the grid.
    first, last = _overlap(starts[:, :2], along[:, :2], low, high)
    kept = last > first
    starts, along, foot = starts[kept], along[kept], foot[kept]
    first, last = first[kept], last[kept]
    reach = np.linalg.norm(along[:, :2], axis=1) * (last - first)
    counts = np.ceil(reach / (grid.spacing / 2)).astype(np.int64) + 2
    edge = np.repeat(np.arange(len(starts)), counts)
    rank = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    share = first[edge] + (last - first)[edge] * rank / (counts[edge] - 1)
    return starts[edge] + share[:, None] * along[edge], foot[edge]


def _overlap(start: Values, along: Values, low: Values, high: Values) -> tuple[Values, Values]:
    """Return the shares of segments (N, 2) between which they are inside a rectangle."""
    moving = np.abs(along) > 1e-12
    step = np.where(moving, along, 1.0)
    a, b = (low - start) / step, (high - start) / step
    inside = (start >= low) & (start <= high)
    first = np.where(moving, np.minimum(a, b), np.where(inside, 0.0, 2.0))
    last = np.where(moving, np.maximum(a, b), np.where(inside, 1.0, -1.0))
    return np.clip(first.max(axis=1), 0.0, 1.0), np.clip(last.min(axis=1), 0.0, 1.0)
