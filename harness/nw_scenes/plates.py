"""Boxes whose upper face is a given plane, and what hangs in the air as such boxes.

Benches, bars and open treads become boxes under which there is room.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nw_scenes.grid import Grid
from nw_scenes.mesh import FaceKind
from nw_scenes.scene import Box, Friction

if TYPE_CHECKING:  # Embree loads with it.
    from nw_scenes.surface import Columns, Surface

Values = NDArray[np.float64]
Quaternion = tuple[float, float, float, float]
Index = NDArray[np.int64]

# Neighbouring slabs whose tops differ by less are one, metres.
_SAME = 0.015
# One box stands for a whole slab if it is this full and this flat (metres).
_FULL = 0.85
_FLAT = 0.006
_ANGLES = np.radians(np.arange(0.0, 90.0, 0.5))
_BISECTIONS = 7
# Square metres below which a slab is noise, and metres: upright faces that are scanned with noise
# overhang themselves by slivers, which would catch feet.
_LEAST_AREA = 5e-4
_LEAST_SIDE = 0.015
_SLIVER_AREA = 3e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class Plate:
    """A rectangle in the plan that carries a box below a plane.

    Attributes:
        origin: (2,) middle in the plan, metres, world.
        along: (2,) unit vector of the first side; the second side is a quarter turn to the left.
        half: half lengths of the sides in the plan, metres.
        top: height of the plane at `origin`.
        slopes: rise of the plane per metre along the two sides.
        thickness: vertical extent of the box below the plane, metres.
    """

    origin: Values
    along: Values
    half: tuple[float, float]
    top: float
    slopes: tuple[float, float]
    thickness: float

    @property
    def across(self) -> Values:
        """(2,) unit vector of the second side."""
        return np.array([-self.along[1], self.along[0]])

    def local(self, xy: Values) -> Values:
        """Return points (N, 2) of the plan in coordinates along the sides, from the middle."""
        offset = xy - self.origin
        return np.stack([offset @ self.along, offset @ self.across], axis=-1)

    def covers(self, xy: Values) -> NDArray[np.bool_]:
        """Return which points (N, 2) lie in the rectangle."""
        first, second = np.abs(self.local(xy)).T
        return (first <= self.half[0]) & (second <= self.half[1])

    def plane(self, xy: Values) -> Values:
        """Return the height of the plane at points (N, 2)."""
        return self.top + self.local(xy) @ np.asarray(self.slopes)

    def box(self, *, friction: Friction, kind: FaceKind = "obstacle") -> Box:
        """Return the box."""
        first = np.array([*self.along, self.slopes[0]])
        second = np.array([*self.across, self.slopes[1]])
        normal = np.cross(first, second)
        normal /= np.linalg.norm(normal)
        x = first / np.linalg.norm(first)
        y = np.cross(normal, x)
        depth = self.thickness * float(normal[2]) / 2
        center = np.array([*self.origin, self.top]) - depth * normal
        half = (
            self.half[0] * float(np.linalg.norm(first)),
            self.half[1] * float(np.linalg.norm(second)),
            depth,
        )
        cx, cy, cz = (round(part, 6) for part in center.tolist())
        w, qx, qy, qz = quaternion(np.column_stack([x, y, normal]))
        return Box(
            # Micrometres: the last bits of a CPU change no digest.
            center=(cx, cy, cz),
            half_size=(round(half[0], 6), round(half[1], 6), round(half[2], 6)),
            quat=(round(w, 9) + 0.0, round(qx, 9) + 0.0, round(qy, 9) + 0.0, round(qz, 9) + 0.0),
            friction=friction,
            kind=kind,
        )


def quaternion(rotation: Values) -> Quaternion:
    """Return the w x y z quaternion, w >= 0, of a (3, 3) rotation matrix."""
    m = rotation.tolist()
    trace = m[0][0] + m[1][1] + m[2][2]
    # The largest component first: the others divide by it.
    squares = [trace, m[0][0], m[1][1], m[2][2]]
    largest = squares.index(max(squares))
    if largest == 0:
        w = 0.5 * math.sqrt(1.0 + trace)
        parts = [
            w,
            (m[2][1] - m[1][2]) / (4 * w),
            (m[0][2] - m[2][0]) / (4 * w),
            (m[1][0] - m[0][1]) / (4 * w),
        ]
    else:
        i = largest - 1
        j, k = (i + 1) % 3, (i + 2) % 3
        q = 0.5 * math.sqrt(1.0 + m[i][i] - m[j][j] - m[k][k])
        parts = [0.0] * 4
        parts[0] = (m[k][j] - m[j][k]) / (4 * q)
        parts[1 + i] = q
        parts[1 + j] = (m[j][i] + m[i][j]) / (4 * q)
        parts[1 + k] = (m[k][i] + m[i][k]) / (4 * q)
    sign = -1.0 if parts[0] < 0 else 1.0
    w, x, y, z = (sign * part for part in parts)
    return w, x, y, z


def fit_plane(local: Values, z: Values) -> tuple[float, tuple[float, float], Values]:
    """Return height at 0, slopes, and residuals (N,) of the plane through points.

    Args:
        local: (N, 2) metres.
        z: (N,) metres.
    """
    # Normal equations by hand: LAPACK rounds differently from one CPU to the next.
    middle = local.mean(axis=0)
    x, y = (local - middle).T
    height = float(z.mean())
    xx, yy, xy = float((x * x).sum()), float((y * y).sum()), float((x * y).sum())
    xz, yz = float((x * z).sum()), float((y * z).sum())
    determinant = xx * yy - xy * xy
    if determinant > 1e-12 * max(xx, yy, 1e-9) ** 2:
        a = (xz * yy - yz * xy) / determinant
        b = (yz * xx - xz * xy) / determinant
    else:
        a, b = (xz / xx if xx > 0 else 0.0), 0.0
    residual = z - (height + a * x + b * y)
    return height - a * float(middle[0]) - b * float(middle[1]), (a, b), residual


@dataclass(frozen=True, kw_only=True, eq=False)
class _Slab:
    """Samples of one slab: (N, 2) metres, rows and columns (N, 2), and its extent (N,), metres."""

    xy: Values
    cells: Index
    top: Values
    bottom: Values

    def take(self, chosen: NDArray[np.bool_]) -> _Slab:
        return _Slab(
            xy=self.xy[chosen],
            cells=self.cells[chosen],
            top=self.top[chosen],
            bottom=self.bottom[chosen],
        )


def overhang_plates(
    columns: Columns, grid: Grid, surface: Surface, *, most: int
) -> tuple[Plate, ...]:
    """Return plates for all slabs above the ground.

    Args:
        columns: what lies above the samples of the grid.
        grid: of the samples.
        surface: for finding the sides of a slab between samples.
        most: plates; a slab of no simple form, such as a bush, could take thousands.
    """
    if len(columns.slab_of) == 0:
        return ()
    cells = np.stack(np.divmod(columns.slab_of, grid.columns), axis=-1)
    samples = _Slab(
        xy=grid.points()[columns.slab_of],
        cells=cells,
        top=columns.slab_top,
        bottom=columns.slab_bottom,
    )
    labels = _connected(columns.slab_of, columns.slab_top, grid)
    names, sizes = np.unique(labels, return_counts=True)
    plates: list[Plate] = []
    # The largest first: they matter most if there are too many.
    for name in names[np.argsort(-sizes, kind="stable")]:
        slab = samples.take(labels == name)
        if len(slab.top) * grid.spacing**2 < _LEAST_AREA or len(plates) >= most:
            break
        if _is_sliver(slab, grid.spacing):
            continue
        whole = _whole(slab, grid.spacing)
        if whole is None:
            plates += _pieces(slab, grid, most)
            continue
        plate = _trimmed(whole, grid, surface)
        if 2 * min(plate.half) >= _LEAST_SIDE:
            plates.append(plate)
    return tuple(plates[:most])


def _connected(slab_of: Index, top: Values, grid: Grid) -> Index:
    """Return a label for each slab sample; neighbours with tops at one height share it."""
    order = np.argsort(slab_of, kind="stable")
    ordered = slab_of[order]
    pairs: list[Index] = []
    for offset in (1, grid.columns, grid.columns + 1, grid.columns - 1):
        first = np.searchsorted(ordered, ordered + offset, side="left")
        last = np.searchsorted(ordered, ordered + offset, side="right")
        for rank in range(int((last - first).max(initial=0))):
            has = first + rank < last
            a, b = order[has], order[(first + rank)[has]]
            close = np.abs(top[a] - top[b]) < _SAME
            # The last sample of a row and the first of the next are no neighbours.
            close &= np.abs(slab_of[a] % grid.columns - slab_of[b] % grid.columns) <= 1
            pairs.append(np.stack([a[close], b[close]]))
    labels = np.arange(len(top))
    a, b = np.concatenate(pairs, axis=1) if pairs else np.zeros((2, 0), dtype=np.int64)
    while True:
        first, second = labels[a], labels[b]
        differ = first != second
        if not differ.any():
            return labels
        low = np.minimum(first, second)[differ]
        np.minimum.at(labels, np.maximum(first, second)[differ], low)
        while (labels[labels] != labels).any():
            labels = labels[labels]


def _is_sliver(slab: _Slab, spacing: float) -> bool:
    """Return whether a slab is small and at most two samples wide."""
    wide = int(np.ptp(slab.cells, axis=0).min()) + 1
    return wide <= 2 and len(slab.top) * spacing**2 < _SLIVER_AREA


def _whole(slab: _Slab, spacing: float) -> Plate | None:
    """Return the one plate that a slab is, or None if it is no flat rectangle."""
    c, s = np.cos(_ANGLES), np.sin(_ANGLES)
    u = slab.xy[:, :1] * c + slab.xy[:, 1:] * s
    v = slab.xy[:, 1:] * c - slab.xy[:, :1] * s
    sides = np.stack([np.ptp(u, axis=0), np.ptp(v, axis=0)]) + spacing
    best = int(np.argmin(sides[0] * sides[1]))
    if len(slab.top) * spacing**2 < _FULL * sides[0, best] * sides[1, best]:
        return None
    along = np.array([c[best], s[best]])
    across = np.array([-s[best], c[best]])
    middle = [float(part[:, best].max() + part[:, best].min()) / 2 for part in (u, v)]
    origin = middle[0] * along + middle[1] * across
    local = np.stack([u[:, best] - middle[0], v[:, best] - middle[1]], axis=-1)
    top, slopes, residual = fit_plane(local, slab.top)
    if np.quantile(np.abs(residual), 0.98) > _FLAT:
        return None
    return Plate(
        origin=origin,
        along=along,
        half=(float(sides[0, best]) / 2, float(sides[1, best]) / 2),
        top=top,
        slopes=slopes,
        thickness=float(np.median(slab.top - slab.bottom)),
    )


def _trimmed(plate: Plate, grid: Grid, surface: Surface) -> Plate:
    """Return a plate with its four sides where the slab ends, found by looking between samples."""
    directions = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    axes = np.stack([plate.along, plate.across])
    reach = np.abs(directions) @ np.asarray(plate.half)
    inner, outer = np.maximum(reach - 1.2 * grid.spacing, 0.0), reach + 0.8 * grid.spacing
    for _ in range(_BISECTIONS):
        trial = (inner + outer) / 2
        xy = plate.origin + (trial[:, None] * directions) @ axes
        columns = surface.columns(xy)
        expected = plate.plane(xy)
        there = np.zeros(4, dtype=np.bool_)
        matching = np.abs(columns.slab_top - expected[columns.slab_of]) < _SAME
        there[columns.slab_of[matching]] = True
        inner, outer = np.where(there, trial, inner), np.where(there, outer, trial)
    right, left, front, back = inner.tolist()
    shift = np.array([(right - left) / 2, (front - back) / 2])
    return Plate(
        origin=plate.origin + shift @ axes,
        along=plate.along,
        half=((right + left) / 2, (front + back) / 2),
        top=plate.top + float(shift @ np.asarray(plate.slopes)),
        slopes=plate.slopes,
        thickness=plate.thickness,
    )


def _pieces(slab: _Slab, grid: Grid, most: int) -> list[Plate]:
    """Return level plates that cover a slab of any form, row by row."""
    low = slab.cells.min(axis=0)
    shape = slab.cells.max(axis=0) - low + 1
    top = np.full(shape, np.nan)
    bottom = np.full(shape, np.nan)
    rows, columns = (slab.cells - low).T
    top[rows, columns], bottom[rows, columns] = slab.top, slab.bottom
    plates: list[Plate] = []
    while len(plates) < most and not np.isnan(top).all():
        row, column = (int(part) for part in np.argwhere(~np.isnan(top))[0])
        rows_end, columns_end = _grow(top, row, column)
        part = (slice(row, rows_end), slice(column, columns_end))
        height = float(np.nanmean(top[part]))
        size = np.array([columns_end - column, rows_end - row])
        corner = np.array([low[1] + column, low[0] + row])
        plates.append(
            Plate(
                origin=np.array([grid.x0, grid.y0]) + grid.spacing * (corner + (size - 1) / 2),
                along=np.array([1.0, 0.0]),
                half=(float(size[0]) * grid.spacing / 2, float(size[1]) * grid.spacing / 2),
                top=height,
                slopes=(0.0, 0.0),
                thickness=max(height - float(np.nanmean(bottom[part])), 0.005),
            )
        )
        top[part] = np.nan
    return plates


def _grow(top: Values, row: int, column: int) -> tuple[int, int]:
    """Return the ends of a rectangle of one height that begins at a sample."""
    start = top[row, column]

    def level(part: Values) -> bool:
        return bool((np.abs(part - start) < _SAME).all())

    columns_end, rows_end = column + 1, row + 1
    while columns_end < top.shape[1] and level(top[row : row + 1, columns_end]):
        columns_end += 1
    while rows_end < top.shape[0] and level(top[rows_end, column:columns_end]):
        rows_end += 1
    return rows_end, columns_end
