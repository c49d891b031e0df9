"""A regular grid of points over the ground, and how deep each lies below the trail."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]

# Points of one grid; a longer trail gets coarser samples.
_MOST_POINTS = 3_000_000


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
    """Return the trail's height at its point nearest to each of `xy`: (K, 3), (N, 2) -> (N,)."""
    best = np.full(len(xy), np.inf)
    height = np.zeros(len(xy))
    ends = trail if len(trail) > 1 else np.repeat(trail, 2, axis=0)
    for start, end in pairwise(ends):
        along = end[:2] - start[:2]
        length = float(along @ along)
        offset = xy - start[:2]
        share = np.zeros(len(xy)) if length == 0 else np.clip((offset @ along) / length, 0, 1)
        distance = ((offset - share[:, None] * along) ** 2).sum(axis=1)
        closer = distance < best
        best[closer] = distance[closer]
        height[closer] = (start[2] + share * (end[2] - start[2]))[closer]
    return height


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
