"""What lies under a point: the ground that the robot walks on, and what hangs above it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_scenes.grid import TerrainOptions, trail_heights
from nw_scenes.mesh import TriangleMesh
from nw_scenes.rays import RayScene

Values = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Surfaces that a ray meets on its way down, and solids that are kept apart there.
_MOST_HITS = 12
_MOST_SLABS = 4
# A ray goes on this far below what it met; thinner slabs are seen as one surface.
_BELOW = 2e-4
# What is no higher than this above the course is walked on, metres.
_ON_TRAIL = 0.3
# Less air than this between two solids is none.
_LEAST_GAP = 0.03


@dataclass(frozen=True, kw_only=True)
class Columns:
    """What N vertical lines meet.

    Attributes:
        ground: (N,) height of the surface to walk on, metres; nan where there is none.
        slab_of: (M,) which line each slab above the ground is on.
        slab_top, slab_bottom: (M,) its extent, metres.
        sheets: (N,) whether a single sheet without an underside hangs overhead.
    """

    ground: Values
    slab_of: NDArray[np.int64]
    slab_top: Values
    slab_bottom: Values
    sheets: Mask


class Surface:
    """A mesh seen from above along a course.

    Solids are told from air by the way that faces look: going down, an upward face enters a solid,
    a downward face leaves one, and solids may overlap. The ground is the lowest solid within reach
    of the course; solids above it with air between, up to the headroom, are slabs.
    """

    def __init__(
        self, mesh: TriangleMesh, trail: Values, options: TerrainOptions, rays: RayScene | None
    ) -> None:
        """Prepare a mesh; `trail` is (K, 3), metres, and begins at the spawn."""
        self._rays = RayScene(mesh) if rays is None else rays
        self._options = options
        self.trail = trail
        corners = mesh.triangles
        self._corner = corners[:, 0]
        self._normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self._low = corners[:, :, 2].min(axis=1)
        self._high = corners[:, :, 2].max(axis=1)
        self._top = float(mesh.vertices[:, 2].max()) + 1.0

    def ceiling(self, xy: Values) -> Values:
        """Return the height above which nothing counts, (N,)."""
        return trail_heights(self.trail, xy) + self._options.headroom

    def ground(self, xy: Values) -> Values:
        """Return only the ground of `columns`, (N,)."""
        return self.columns(xy).ground

    def columns(self, xy: Values) -> Columns:
        """Look down at points (N, 2)."""
        z, enters = self._hits(xy)
        reference = trail_heights(self.trail, xy)
        tops, bottoms, sheets = _slabs(z, enters, self._options.headroom, reference + _ON_TRAIL)
        ceiling = reference + self._options.headroom
        # Thin gaps close from the top down; what begins above the ceiling is not there.
        for slab in range(_MOST_SLABS - 1):
            touch = bottoms[slab] - tops[slab + 1] < _LEAST_GAP
            tops[slab + 1][touch] = tops[slab][touch]
            tops[slab][touch] = np.nan
        tops[bottoms >= ceiling] = np.nan
        tops = np.minimum(tops, ceiling)
        ground_slab = _ground_slab(tops, reference - self._options.reach_down)
        lines = np.arange(len(xy))
        above = ~np.isnan(tops) & (np.arange(_MOST_SLABS)[:, None] < ground_slab)
        slab, slab_of = np.nonzero(above)
        return Columns(
            ground=tops[ground_slab, lines],
            slab_of=slab_of,
            slab_top=tops[slab, slab_of],
            slab_bottom=bottoms[slab, slab_of],
            sheets=sheets,
        )

    def _hits(self, xy: Values) -> tuple[Values, Mask]:
        """Return what each line meets from the top: (L, N) heights, nan after the last; upward?"""
        count = len(xy)
        heights = np.full((_MOST_HITS, count), np.nan)
        enters = np.zeros((_MOST_HITS, count), dtype=np.bool_)
        hits = np.zeros(count, dtype=np.int64)
        lines = np.arange(count)
        start = np.full(count, self._top)
        down = np.broadcast_to(np.array([0.0, 0.0, -1.0]), (count, 3))
        for _ in range(2 * _MOST_HITS):
            if len(lines) == 0:
                break
            origins = np.column_stack([xy[lines], start[lines]])
            face = self._rays.cast(origins, down[: len(lines)])[1]
            lines, face = lines[face >= 0], face[face >= 0]
            normal, corner = self._normal[face], self._corner[face]
            flat = np.abs(normal[:, 2]) > 1e-4 * np.linalg.norm(normal, axis=1)
            offset = ((xy[lines] - corner[:, :2]) * normal[:, :2]).sum(axis=1)
            z = corner[:, 2] - offset / np.where(flat, normal[:, 2], 1.0)
            # Rays graze vertical faces by rounding; they are neither entered nor left.
            z = np.clip(np.where(flat, z, start[lines]), self._low[face], self._high[face])
            z = np.minimum(z, start[lines])
            kept = flat & (hits[lines] < _MOST_HITS)
            heights[hits[lines[kept]], lines[kept]] = z[kept]
            enters[hits[lines[kept]], lines[kept]] = normal[kept, 2] > 0
            hits[lines[kept]] += 1
            start[lines] = z - _BELOW
            lines = lines[hits[lines] < _MOST_HITS]
        return heights, enters


def _slabs(
    z: Values, enters: Mask, headroom: float, lowest_roof: Values
) -> tuple[Values, Values, Mask]:
    """Return tops and bottoms of solids, (S, N) from above, and where sheets hang, (N,)."""
    count = z.shape[1]
    tops = np.full((_MOST_SLABS, count), np.nan)
    bottoms = np.full((_MOST_SLABS, count), np.nan)
    number = np.full(count, -1)
    depth = np.zeros(count, dtype=np.int64)
    second = np.full(count, np.nan)
    lines = np.arange(count)
    for height, entering in zip(z, enters, strict=True):
        met = ~np.isnan(height)
        into, out = met & entering, met & ~entering
        new = lines[into & (depth == 0) & (number < _MOST_SLABS - 1)]
        number[new] += 1
        tops[number[new], new] = height[new]
        bottoms[number[new], new] = -np.inf
        inner = into & (depth > 0) & np.isnan(second)
        second[inner] = height[inner]
        leaves = lines[out & (depth == 1)]
        bottoms[number[leaves], leaves] = height[leaves]
        second[leaves] = np.nan
        depth += into
        depth -= out & (depth > 0)
    # Two surfaces entered, at least one never left, and far apart: the upper one is a single sheet,
    # such as a roof scanned from above, and not the top of a block as high as a house. What the
    # course leads over is no roof.
    last = np.maximum(number, 0)
    top = tops[last, lines]
    sheets = (depth > 1) & (top - second > headroom) & (top > lowest_roof)
    tops[last[sheets], lines[sheets]] = second[sheets]
    return tops, bottoms, sheets


def _ground_slab(tops: Values, lowest: Values) -> NDArray[np.int64]:
    """Return the number of the lowest slab that ends above `lowest`, else of the highest."""
    reachable = tops >= lowest
    last = _MOST_SLABS - 1 - np.argmax(reachable[::-1], axis=0)
    first = np.argmax(~np.isnan(tops), axis=0)
    return np.where(reachable.any(axis=0), last, first)
