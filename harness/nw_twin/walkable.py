"""Where a robot can walk: level by level, and which places are connected.

A grid of vertical lines meets the surfaces of a mesh. A robot can stand where one faces up, is
no steep slope, and has headroom; a robot fits where most positions around it are as high, but for a
step, and nothing is beside it: the walls of scans are sheets, which no vertical line meets. What
it reaches from a position, through doors and over stairs, is one region.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_scenes.mesh import TriangleMesh
from nw_scenes.rays import RayScene

Values = NDArray[np.float64]
Labels = NDArray[np.int64]

_CELL, _MOST_CELLS = 0.1, 300
"""Distance of the lines, m, and how many there are each way; of a large mesh they are wider."""
_LEVELS = 8
"""Surfaces that a line meets, at most."""
_BELOW = 0.02
"""A line goes on so far below what it met, m."""
_STEEP = math.cos(math.radians(40.0))
_HEADROOM, _STEP, _HALF_WIDTH = 0.6, 0.25, 0.2
"""Of a quadruped, m; the step is also that between lines, on stairs and slopes."""
_BODY, _WAYS = 0.3, 8
"""Height over the ground at which nothing may be beside a robot, m, and directions that count."""
_AROUND = 0.8
"""Share of the positions around that are there where a robot fits: scans have small holes."""
_UNDER = (0.15, 3.0)
"""How far below a camera the floor is that somebody walked on, m."""
_ASIDE = 1.0
"""How far aside: cameras look ahead, and rarely at what lies below them, m."""
_LEAST = 1.0
"""Of a floor, m2."""
_VOTES = 0.3
"""Share of the cameras above a region that somebody walked on, of those above any."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Walkable:
    """Places on which a robot fits, by the regions that are connected; the largest one is 0.

    Attributes:
        low: (2,) corner of the grid, m.
        cell: distance of the lines, m.
        points: (N, 3) on the ground, m.
        region: (N,) number of the region that each is in.
        areas: (R,) of the regions, m2, in descending order.
    """

    low: Values
    cell: float
    points: Values
    region: Labels
    areas: Values

    def largest(self, floor: float | None = None) -> int | None:
        """Return the largest region, of those most of which lie at a height, m, if there are some.

        None where there is no region at all.
        """
        if floor is not None:
            for region in np.flatnonzero(self.areas > _LEAST).tolist():
                if abs(self.height(region) - floor) < _STEP:
                    return region
        return 0 if len(self.areas) else None

    def walked(self, centres: Values) -> int | None:
        """Return the region that somebody walked on: the largest under enough of the cameras.

        Args:
            centres: (V, 3) of the cameras, m.

        Returns:
            None where there is no region; the largest one where no camera is above any.
        """
        if not len(self.areas):
            return None
        votes = np.zeros(len(self.areas))
        for centre in centres:
            under = centre[2] - self.points[:, 2]
            aside = np.linalg.norm(self.points[:, :2] - centre[:2], axis=1)
            near = np.flatnonzero((under > _UNDER[0]) & (under < _UNDER[1]) & (aside < _ASIDE))
            votes[np.unique(self.region[near])] += 1.0
        enough = np.flatnonzero(votes >= _VOTES * max(float(votes.max()), 1.0)).tolist()
        return enough[0] if enough else 0

    def under(self, region: int, xy: Values) -> Values:
        """Return the height of a region at points (N, 2), m; nan where a robot does not fit."""
        places = self.points[self.region == region]
        cells = np.floor((places[:, :2] - self.low) / self.cell).astype(np.int64)
        grid = np.full(cells.max(axis=0) + 1, np.nan)
        grid[tuple(cells.T)] = places[:, 2]
        wanted = np.floor((xy - self.low) / self.cell).astype(np.int64)
        inside = np.logical_and.reduce((wanted >= 0) & (wanted < grid.shape), axis=1)
        heights = grid[tuple(np.where(inside[:, None], wanted, 0).T)]
        return np.where(inside, heights, np.nan)

    def height(self, region: int) -> float:
        """Return the height at which most of a region lies, m."""
        z = self.points[self.region == region, 2]
        places = np.round(z / _STEP).astype(np.int64)
        most = int(np.bincount(places - places.min()).argmax()) + int(places.min())
        return float(np.median(z[places == most]))


def walkable(mesh: TriangleMesh, rays: RayScene | None = None) -> Walkable:
    """Return where a robot can walk on a mesh in metres, z up, faces looking out of solids."""
    rays = RayScene(mesh) if rays is None else rays
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    cell = max(_CELL, float((high - low)[:2].max()) / _MOST_CELLS)
    shape = tuple(np.maximum(np.ceil((high - low)[:2] / cell), 1).astype(int).tolist())
    lines = low[:2] + (np.indices(shape).reshape(2, -1).T + 0.5) * cell
    z = _standing(mesh, rays, lines, float(high[2])).reshape(-1, *shape)
    reach = max(1, math.ceil(_HALF_WIDTH / cell))
    ways = [
        (i, j)
        for i in range(-reach, reach + 1)
        for j in range(-reach, reach + 1)
        if (i or j) and math.hypot(i, j) * cell <= _HALF_WIDTH + 0.5 * cell
    ]
    beside = np.zeros(z.shape)
    for way in ways:
        beside += np.isfinite(_nearest(z, way))
    fits = np.isfinite(z) & (beside >= _AROUND * len(ways))
    level, i, j = np.nonzero(fits)
    xy = lines.reshape(*shape, 2)
    fits[level, i, j] = _free(rays, np.column_stack([xy[i, j], z[level, i, j]]))
    number = np.full(z.shape, -1, dtype=np.int64)
    number[fits] = np.arange(int(np.count_nonzero(fits)))
    first, second = _steps(np.where(fits, z, np.nan), number)
    region = _connected(int(np.count_nonzero(fits)), first, second)
    _, region, counts = np.unique(region, return_inverse=True, return_counts=True)
    order = np.argsort(-counts, kind="stable")
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    level, i, j = np.nonzero(fits)
    return Walkable(
        low=low[:2],
        cell=cell,
        points=np.column_stack([xy[i, j], z[level, i, j]]),
        region=rank[region],
        areas=(counts[order] * cell * cell).astype(np.float64),
    )


def _standing(mesh: TriangleMesh, rays: RayScene, xy: Values, top: float) -> Values:
    """Return heights (L, N) of what faces up below points (N, 2), with headroom; nan for none."""
    corners = mesh.triangles
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    up = normal[:, 2] / np.maximum(np.linalg.norm(normal, axis=1), 1e-300)
    heights = np.full((_LEVELS, len(xy)), np.nan)
    above, start = np.full(len(xy), np.inf), np.full(len(xy), top + 1.0)
    lines = np.arange(len(xy))
    down = np.tile([0.0, 0.0, -1.0], (len(xy), 1))
    for level in range(_LEVELS):
        distance, face = rays.cast(np.column_stack([xy[lines], start[lines]]), down[: len(lines)])
        there = face >= 0
        lines, face, z = lines[there], face[there], (start[lines] - distance)[there]
        stands = (up[face] > _STEEP) & (above[lines] - z > _HEADROOM)
        heights[level, lines[stands]] = z[stands]
        above[lines], start[lines] = z, z - _BELOW
    return heights


def _free(rays: RayScene, places: Values) -> NDArray[np.bool_]:
    """Return at which places (N, 3) nothing is beside a robot's body."""
    eyes = places + np.array([0.0, 0.0, _BODY])
    free = np.ones(len(places), dtype=np.bool_)
    for turn in range(_WAYS):
        angle = 2.0 * math.pi * turn / _WAYS
        way = np.tile([math.cos(angle), math.sin(angle), 0.0], (len(places), 1))
        free &= rays.distance(eyes, way) > _HALF_WIDTH
    return free


def _nearest(z: Values, way: tuple[int, int]) -> Values:
    """Return the height (L, I, J) nearest to each of the line that lies so many cells on."""
    other = np.full_like(z, np.nan)
    best = np.full_like(z, np.nan)
    (i, j), (rows, columns) = way, z.shape[1:]
    here = (slice(max(0, -i), rows - max(0, i)), slice(max(0, -j), columns - max(0, j)))
    there = (slice(max(0, i), rows - max(0, -i)), slice(max(0, j), columns - max(0, -j)))
    other[:, here[0], here[1]] = z[:, there[0], there[1]]
    for level in other:
        apart = np.abs(level - z)
        best = np.where((apart <= _STEP) & ~(apart >= np.abs(best - z)), level, best)
    return best


def _steps(z: Values, number: Labels) -> tuple[Labels, Labels]:
    """Return the numbers of each two places from one to the next of which a robot steps."""
    pairs: list[tuple[Labels, Labels]] = []
    for axis in (1, 2):
        end = z.shape[axis] - 1
        near = [np.take(one, np.arange(end), axis) for one in (z, number)]
        far = [np.take(one, np.arange(1, end + 1), axis) for one in (z, number)]
        for a in range(len(z)):
            for b in range(len(z)):
                step = np.abs(near[0][a] - far[0][b]) <= _STEP
                pairs.append((near[1][a][step], far[1][b][step]))
    return np.concatenate([a for a, _ in pairs]), np.concatenate([b for _, b in pairs])


def _connected(count: int, first: Labels, second: Labels) -> Labels:
    """Return a label for each of so many places; those that pairs connect have the same one."""
    label = np.arange(count)
    while True:
        roots = np.minimum(label[first], label[second])
        before = label.copy()
        np.minimum.at(label, before[first], roots)
        np.minimum.at(label, before[second], roots)
        while (label[label] != label).any():
            label = label[label]
        if (label == before).all():
            return label
