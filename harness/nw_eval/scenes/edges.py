"""Man-made edges: boxes behind straight, upright faces that a height field would bevel.

Between two samples a height field can only slope, so a riser becomes a ramp one cell wide. Where
the mesh jumps along a straight line and the upper side is flat behind it, a box replaces
the last samples: its face is the riser, its top is the tread, and the samples below it are lowered
so that nothing of the slope shows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_eval.scenes.grid import Grid, TerrainOptions, shifted
from nw_eval.scenes.plates import Plate, fit_plane
from nw_eval.scenes.surface import Surface

Values = NDArray[np.float64]
Mask = NDArray[np.bool_]

_BISECTIONS = 6
# How far an edge may stray from a straight line, and a tread from a plane, metres.
_STRAIGHT = 0.006
_FLAT = 0.006
# Slope of a tread away from its edge beyond which the face of a box would lean.
_LEAN = 0.02
_SHORTEST = 0.08
# Points on one line whose heights differ by more belong to two treads, metres.
_NEXT_TREAD = 0.02
_RUNS = 60
# Lines in a row that carry no plate, after which nothing man-made is left: rubble has no end.
_FRUITLESS = 25
_MOST_PLATES = 200
# How far a box goes into the ground in front of it, metres.
_ROOT = 0.05
# Steps that a box reaches back from its face.
_BACK = 3.0


@dataclass(frozen=True, kw_only=True, eq=False)
class _Edges:
    """Points on jumps of the ground.

    Attributes:
        xy: (N, 2) metres.
        down: (N, 2) unit vector along a row or column of the grid, to the lower side.
        low, high: (N,) heights to either side, metres.
    """

    xy: Values
    down: Values
    low: Values
    high: Values

    def take(self, chosen: Mask | NDArray[np.int64]) -> _Edges:
        return _Edges(
            xy=self.xy[chosen],
            down=self.down[chosen],
            low=self.low[chosen],
            high=self.high[chosen],
        )


def edge_plates(
    heights: Values, grid: Grid, surface: Surface, options: TerrainOptions
) -> tuple[Plate, ...]:
    """Return a plate for every straight, upright face of the ground that is worth one.

    Args:
        heights: (R, C) metres, nan where there is no ground.
        grid: of the heights.
        surface: for looking between the samples.
        options: give the least height of a step.
    """
    edges = _find(heights, grid, surface, options.least_step)
    plates: list[Plate] = []
    random = np.random.default_rng(0)
    fruitless = 0
    while len(edges.xy) and len(plates) < _MOST_PLATES and fruitless < _FRUITLESS:
        chosen, line = _line(edges, random)
        if chosen is None:
            break
        fruitless += 1
        for part in _stretches(edges, chosen, line, 3 * grid.spacing):
            plate = _plate(part, line, grid.spacing, surface)
            if plate is not None:
                plates.append(plate)
                fruitless = 0
        rest = np.ones(len(edges.xy), dtype=np.bool_)
        rest[chosen] = False
        edges = edges.take(rest)
    return tuple(plates)


def lower_under(
    heights: Values, grid: Grid, plates: tuple[Plate, ...], least_step: float
) -> Values:
    """Lower the samples whose slope would show in front of a plate.

    A sample under a plate goes down to its lowest neighbour if all neighbours that stay up are
    under a plate as well: then the slope between is inside a box. Returns (R, C) heights.
    """
    points = grid.points()
    covered = np.zeros(grid.shape, dtype=np.bool_)
    for plate in plates:
        covered.ravel()[plate.covers(points)] = True
    around = shifted(heights, np.nan)
    below = around < heights - least_step
    under = shifted(covered.astype(np.float64), 0.0) > 0
    hidden = (below | under | np.isnan(around)).all(axis=0)
    sinks = covered & below.any(axis=0) & hidden
    lowest = np.where(below, around, np.inf).min(axis=0)
    return np.where(sinks, lowest, heights)


def _find(heights: Values, grid: Grid, surface: Surface, least: float) -> _Edges:
    """Return where neighbouring samples differ by a jump, found to a few tenths of a millimetre."""
    points = grid.points().reshape(*grid.shape, 2)
    pairs: list[tuple[Values, Values, Values, Values]] = []
    for first, second in (
        ((slice(None), slice(None, -1)), (slice(None), slice(1, None))),
        ((slice(None, -1), slice(None)), (slice(1, None), slice(None))),
    ):
        a, b = heights[first], heights[second]
        jumps = np.abs(a - b) > least
        pairs.append((points[first][jumps], points[second][jumps], a[jumps], b[jumps]))
    p, q, zp, zq = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
    swap = zp > zq
    low, high = np.where(swap[:, None], q, p), np.where(swap[:, None], p, q)
    z_low, z_high = np.where(swap, zq, zp), np.where(swap, zp, zq)
    step = np.linalg.norm(high - low, axis=1, keepdims=True)
    down = (low - high) / np.where(step > 0, step, 1.0)
    for _ in range(_BISECTIONS):
        if len(low) == 0:
            break
        middle = (low + high) / 2
        z = surface.ground(middle)
        up = np.abs(z - z_high) < np.abs(z - z_low)
        high, z_high = np.where(up[:, None], middle, high), np.where(up, z, z_high)
        low, z_low = np.where(up[:, None], low, middle), np.where(up, z_low, z)
    upright = z_high - z_low > least
    return _Edges(xy=(low + high) / 2, down=down, low=z_low, high=z_high).take(upright)


def _line(edges: _Edges, random: np.random.Generator) -> tuple[NDArray[np.int64] | None, Values]:
    """Return the points on the line that most points share, and its direction (2,)."""
    count = len(edges.xy)
    least = 6
    best: NDArray[np.int64] | None = None
    direction = np.array([1.0, 0.0])
    if count < least:
        return None, direction
    for _ in range(_RUNS):
        first = int(random.integers(count))
        # A partner nearby, so that it is likely on the same edge.
        offset = edges.xy - edges.xy[first]
        distance = np.abs(offset).max(axis=1)
        near = np.flatnonzero((distance > _SHORTEST / 2) & (distance < 10 * _SHORTEST))
        if len(near) == 0:
            continue
        second = int(near[random.integers(len(near))])
        along = offset[second] / np.linalg.norm(offset[second])
        normal = np.array([-along[1], along[0]])
        if edges.down[first] @ normal < 0:
            normal, along = -normal, -along
        chosen = np.flatnonzero((np.abs(offset @ normal) < _STRAIGHT) & (edges.down @ normal > 0.1))
        if len(chosen) >= least and (best is None or len(chosen) > len(best)):
            best, direction = chosen, along
    return best, direction


def _stretches(edges: _Edges, chosen: NDArray[np.int64], line: Values, gap: float) -> list[_Edges]:
    """Return the parts of a line that are long enough and without gaps, each of one tread."""
    position = edges.xy[chosen] @ line
    order = np.argsort(position, kind="stable")
    position, ordered = position[order], chosen[order]
    breaks = (np.diff(position) > gap) | (np.abs(np.diff(edges.high[ordered])) > _NEXT_TREAD)
    parts = np.split(np.arange(len(ordered)), np.flatnonzero(breaks) + 1)
    return [
        edges.take(ordered[part])
        for part in parts
        if position[part[-1]] - position[part[0]] >= _SHORTEST
    ]


def _plate(edges: _Edges, along: Values, spacing: float, surface: Surface) -> Plate | None:
    """Return the plate behind one straight stretch, or None where the upper side is not flat."""
    # A better line through the stretch than through two of its points.
    middle = edges.xy.mean(axis=0)
    s = (edges.xy - middle) @ along
    normal = np.array([-along[1], along[0]])
    d = (edges.xy - middle) @ normal
    tilt = float((s * d).sum() / (s * s).sum())
    along = (along + tilt * normal) / np.hypot(1.0, tilt)
    normal = np.array([-along[1], along[0]])
    s = (edges.xy - middle) @ along
    start, stop = float(s.min()), float(s.max())
    behind = -normal
    depth = _BACK * spacing
    inset = min(0.25 * spacing, (stop - start) / 4)
    rows = np.linspace(start + inset, stop - inset, max(int((stop - start) / spacing), 3))
    back = np.array([0.04, 0.3, 0.65, 0.98]) * depth
    local = np.stack(np.meshgrid(rows, back, indexing="ij"), axis=-1).reshape(-1, 2)
    z = surface.ground(middle + local[:, :1] * along + local[:, 1:] * behind)
    if np.isnan(z).any():
        return None
    height, (rise, lean), residual = fit_plane(local, z)
    if np.abs(residual).max() > _FLAT or abs(lean) > _LEAN:
        return None
    start, stop = _ends(start, stop, (height, rise), middle, along, behind, (spacing, surface))
    center = (start + stop) / 2
    low = float(edges.low.min())
    top = height + rise * center + lean * depth / 2
    lowest = top - abs(rise) * (stop - start) / 2
    # `across` of a plate is a quarter turn left of `along`, and `behind` must be either side.
    return Plate(
        origin=middle + center * along + depth / 2 * behind,
        along=along,
        half=((stop - start) / 2, depth / 2),
        top=top,
        slopes=(rise, 0.0),
        thickness=max(lowest - low, 0.0) + abs(rise) * (stop - start) + _ROOT,
    )


def _ends(
    start: float,
    stop: float,
    plane: tuple[float, float],
    middle: Values,
    along: Values,
    behind: Values,
    look: tuple[float, Surface],
) -> tuple[float, float]:
    """Move both ends out to where the tread ends, at most one and a half steps."""
    spacing, surface = look
    inner = np.array([start, stop])
    outer = inner + 1.5 * spacing * np.array([-1.0, 1.0])
    for _ in range(_BISECTIONS + 2):
        trial = (inner + outer) / 2
        z = surface.ground(middle + trial[:, None] * along + 0.1 * spacing * behind)
        there = np.abs(z - (plane[0] + plane[1] * trial)) < _FLAT
        inner, outer = np.where(there, trial, inner), np.where(there, outer, trial)
    return float(inner[0]), float(inner[1])
