"""How a mesh becomes terrain: the options, and the grid of points over the ground.

The grid is regular; it knows how deep each point lies below the course.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from nw_base.words import Collision
from nw_scenes.scene import DEFAULT_FRICTION, Friction

# Raise it with every change of a solid or a finding of any scene: it is part of the cache's key.
COMPILER_VERSION = 6

Mask = NDArray[np.bool_]
Leg = tuple[NDArray[np.float64], NDArray[np.float64]]

# Points of one grid; a longer course gets coarser samples.
_MOST_POINTS = 3_000_000
# Beyond so many waypoints, points are compared with the legs near their tile only.
_FEW_LEGS = 32
_TILES = 32  # along a side


@dataclass(frozen=True, kw_only=True)
class TerrainOptions:
    """Lengths in metres.

    Attributes:
        collision: `terrain` is height fields and boxes, fast; `triangles` is the mesh's own ones,
            slow and exact, to check the other with.
        spacing: of the samples near the course. The cost of a step grows with the samples under
            the robot; tests/bench/bench_terrain.py measures it.
        far_spacing: of the samples beyond.
        corridor: what counts as near, to either side of course and spawn.
        reach: how far beyond course and spawn there is terrain at all.
        headroom: what hangs higher above the course than this is passed under.
        reach_down: what lies deeper below the course than this is not where the robot walks.
        largest_hole: square metres of missing surface that are closed by interpolation.
        least_step: height of an edge that is worth a box of its own.
        friction: of every solid.
    """

    collision: Collision = "terrain"
    spacing: float = 0.0125
    far_spacing: float = 0.05
    corridor: float = 0.8
    reach: float = 5.0
    headroom: float = 1.2
    reach_down: float = 1.0
    largest_hole: float = 0.5
    least_step: float = 0.03
    friction: Friction = DEFAULT_FRICTION


@dataclass(frozen=True, kw_only=True)
class Grid:
    """Samples at (x0 + c * spacing, y0 + r * spacing), rows along y. Metres, world."""

    x0: float
    y0: float
    spacing: float
    rows: int
    columns: int

    @classmethod
    def over(cls, low: NDArray[np.float64], high: NDArray[np.float64], spacing: float) -> Grid:
        """Return the grid that covers the rectangle from `low` to `high`, (2,) each."""
        width, depth = (high - low).tolist()
        spacing = max(spacing, float(np.sqrt(width * depth / _MOST_POINTS)))
        columns = max(int(np.ceil(width / spacing)) + 1, 2)
        rows = max(int(np.ceil(depth / spacing)) + 1, 2)
        # Man-made faces lie at round numbers; a sample exactly on one would be a coin's toss.
        shift = -0.3719 * spacing
        return cls(
            x0=float(low[0]) + shift,
            y0=float(low[1]) + shift,
            spacing=spacing,
            rows=rows + 1,
            columns=columns + 1,
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.rows, self.columns

    @property
    def center(self) -> tuple[float, float]:
        """Middle of the grid."""
        x, y = self.half_size
        return self.x0 + x, self.y0 + y

    @property
    def half_size(self) -> tuple[float, float]:
        """Half extents along x and y."""
        return self.spacing * (self.columns - 1) / 2, self.spacing * (self.rows - 1) / 2

    def points(self) -> NDArray[np.float64]:
        """Return all samples, (rows * columns, 2), row by row."""
        x = self.x0 + self.spacing * np.arange(self.columns, dtype=np.float64)
        y = self.y0 + self.spacing * np.arange(self.rows, dtype=np.float64)
        points = np.empty((self.rows, self.columns, 2))
        points[:, :, 0], points[:, :, 1] = x, y[:, None]
        return points.reshape(-1, 2)

    def nearest(self, xy: NDArray[np.float64]) -> tuple[NDArray[np.int64], Mask]:
        """Return the flat index of the sample nearest to each point, and whether there is one."""
        c = np.rint((xy[:, 0] - self.x0) / self.spacing).astype(np.int64)
        r = np.rint((xy[:, 1] - self.y0) / self.spacing).astype(np.int64)
        inside = (c >= 0) & (c < self.columns) & (r >= 0) & (r < self.rows)
        return np.where(inside, r * self.columns + c, 0), inside


def trail_heights(trail: NDArray[np.float64], xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the course's height at its point nearest to each of `xy`: (K, 3), (N, 2) -> (N,)."""
    if len(trail) <= _FEW_LEGS:
        return _nearest_heights(list(pairwise(trail if len(trail) > 1 else trail.repeat(2, 0))), xy)
    legs, tiles = list(pairwise(trail)), _tiles(xy)
    centers = np.array([(xy[tile].min(axis=0) + xy[tile].max(axis=0)) / 2 for tile in tiles])
    far = np.sqrt([_distances(leg, centers)[0] for leg in legs]) if tiles else np.zeros((0, 0))
    heights = np.empty(len(xy))
    for tile, center, away in zip(tiles, centers, far.T, strict=True):
        radius = np.sqrt(((xy[tile] - center) ** 2).sum(axis=1).max())
        # The leg nearest to a point of the tile is hardly farther from its centre than the leg
        # nearest to that.
        near = np.flatnonzero(away <= (away.min() + 2 * radius) * (1 + 1e-9) + 1e-9)
        heights[tile] = _nearest_heights([legs[index] for index in near], xy[tile])
    return heights


def to_trail(
    trail: NDArray[np.float64], xy: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the distance from a course, and how far along it the nearest point is, m.

    Args:
        trail: (K, 3) with K > 1.
        xy: (N, 2).
    """
    away, along, gone = np.full(len(xy), np.inf), np.zeros(len(xy)), 0.0
    for leg in pairwise(trail):
        squared, share = _distances(leg, xy)
        length, distance = float(np.linalg.norm((leg[1] - leg[0])[:2])), np.sqrt(squared)
        along = np.where(distance < away, gone + share * length, along)
        away, gone = np.minimum(away, distance), gone + length
    return away, along


def _tiles(xy: NDArray[np.float64]) -> list[NDArray[np.int64]]:
    """Return the indices of points by the squares that they lie in."""
    low = xy.min(axis=0, initial=np.inf)
    side = float((xy - low).max(initial=0.0)) / _TILES + 1e-9
    column, row = ((xy - low) / side).astype(np.int64).T
    tile = row * (_TILES + 1) + column
    order = np.argsort(tile, kind="stable")
    starts = np.flatnonzero(np.diff(tile[order], prepend=-1))
    return np.split(order, starts[1:]) if len(order) else []


def _nearest_heights(legs: list[Leg], xy: NDArray[np.float64]) -> NDArray[np.float64]:
    best = np.full(len(xy), np.inf)
    height = np.zeros(len(xy))
    for start, end in legs:
        distance, share = _distances((start, end), xy)
        closer = distance < best
        best[closer] = distance[closer]
        height[closer] = (start[2] + share * (end[2] - start[2]))[closer]
    return height


def _distances(leg: Leg, xy: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """Return (N,) squared distances to a leg, and (N,) how far along it the nearest point is."""
    start, end = leg
    along = end[:2] - start[:2]
    length = float(along @ along)
    offset = xy - start[:2]
    share = np.zeros(len(xy)) if length == 0 else np.clip((offset @ along) / length, 0, 1)
    return ((offset - share[:, None] * along) ** 2).sum(axis=1), share


def shifted(values: NDArray[np.float64], fill: float) -> NDArray[np.float64]:
    """Return the eight neighbours of every sample: (R, C) -> (8, R, C), `fill` beyond the rim."""
    padded = np.pad(values, 1, constant_values=fill)
    rows, columns = values.shape
    return np.stack(
        [
            padded[1 + dr : 1 + dr + rows, 1 + dc : 1 + dc + columns]
            for dr in (-1, 0, 1)
            for dc in (-1, 0, 1)
            if (dr, dc) != (0, 0)
        ]
    )
