"""The ground along a walk: where one walked, how high the ground is there, and its pieces.

The way is that of the cameras from above, without what hands do. The ground along it has a height
and leans to the sides; it is cut into what is level, what slopes along the way, and edges.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import SceneError
from nw_scenes.mesh import TriangleMesh
from nw_scenes.rays import RayScene
from nw_twin.walkable import walkable

Values = NDArray[np.float64]
Shown = Callable[[Values], NDArray[np.bool_]]
"""Says at which points (N, 2), metres, photographs show the ground."""

_SIDES = np.array([-0.2, -0.1, 0.0, 0.1, 0.2])
"""Lines beside the way on which the ground is looked at, metres: what a robot stands on."""
_KNOWN = 0.5
"""Least share of a way that has ground below it."""
_STAND = 0.6
"""Of a way without a hole on which a robot can stand, metres."""
_WHOLE = 0.98
"""Share of that ground that is there where it is whole, but for cracks."""
_STEP_ON = 1.0
"""How much farther even ground may lie than ground, metres."""
_BUMP = 0.02
"""Distance from a plane up to which any ground is even, metres."""
_USUAL = 1.25
"""Of rough ground, how many times as far as it usually is from a plane even ground may be."""
_LONGEST_HOLE = 1.0
"""Of a way, metres: a hole as long as a gap that a robot leaps. A longer one ends the way."""
_NOISE = 4.0
"""Standard deviations of rough ground that are no edge."""
_MEDIAN = 5
"""Samples of which the middle one counts: scans have spikes."""

STEP = 0.02
"""Between samples of a way, metres."""

_SMOOTH = 0.6
"""Length over which a way is rounded off, metres: hands and steps swing by less."""
_LEAST = 1.0
"""Of a way that can be a course, metres."""
_SHORTEST = 5
"""Samples of a profile."""
_FREE_CELL, _MOST_CELLS = 0.1, 400
"""Edge of a square of ground where level ground is looked for, metres, and how many, each way."""
_LEVEL = 0.15
"""Difference of heights of level ground, rough or not, metres."""
_FAR = 0.9
"""Share of the farthest camera's distance: the first time that the walk is so far, it is there."""

EDGE_RISE = 0.06
"""What is lower is no edge, metres. On rough ground more is: see `GroundProfile.edge`."""
_EDGE_RUN = 4
"""Samples over which an edge rises at most: scans round it off."""
_GRADE = math.tan(math.radians(6.0))
"""What is flatter is level."""
_GRADE_RUN = 10
"""Samples over which a grade is measured."""
_LEAST_SLOPE = 0.3
"""Of a slope along the way, metres."""
_LEAST_LEVEL = 0.08
"""Of a tread or a bar's top, metres."""
_BESIDE = 8
"""Samples of level ground by which the height of an edge beside it is told: scans round it off."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GroundProfile:
    """The ground along a way, sample by sample.

    Attributes:
        xy: (S, 2) of the way, metres.
        along: (S,) metres from its start.
        height: (S,) metres; across holes of the mesh, straight.
        lean: (S,) slope to the left, tangent; positive where the left is higher.
        known: share of the samples that have ground below them.
        edge: what is lower is no edge, metres: `EDGE_RISE`, more on rough ground such as cobbles.
        left_out: metres of the way before and behind it, beyond holes that are too long.
    """

    xy: Values
    along: Values
    height: Values
    lean: Values
    known: float
    edge: float = EDGE_RISE
    left_out: float = 0.0

    def after(self, start: float) -> GroundProfile:
        """Return the rest of it, from so many metres along."""
        first = round(start / STEP)
        return replace(
            self,
            xy=self.xy[first:],
            along=self.along[first:] - self.along[first],
            height=self.height[first:],
            lean=self.lean[first:],
        )


def ground_along(
    mesh: TriangleMesh, way: Values, below: float, shown: Shown | None = None
) -> GroundProfile:
    """Return the ground along a way.

    Args:
        mesh: in metres, z up, faces counter-clockwise from outside.
        way: (S, 2) metres, evenly spaced.
        below: height from which to look down, metres: that of the cameras, under any ceiling.
        shown: where photographs show the ground; None if unknown.

    Raises:
        SceneError: less than half of the way has ground below it, or it is no way at all.

    The way begins and ends where there is ground to stand on: cameras look ahead, and rarely at
    what lies below the first of them. Of a way with holes longer than 1 m, or
    with ground that no photograph shows for so long, it is the longest piece between them.
    """
    if len(way) < 2:
        raise _too_short(STEP * len(way))
    # A robot stands on ground behind the start, too.
    run = round(_STAND / STEP)
    before = way[0] - np.arange(run, 0, -1)[:, None] * (way[1] - way[0])
    way = np.concatenate([before, way])
    ahead = np.gradient(way, axis=0)
    ahead /= np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-12)
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    points = way[:, None] + _SIDES[:, None] * left[:, None]
    heights = RayScene(mesh).height(points.reshape(-1, 2), z_from=below)
    heights = np.where(np.isfinite(heights), heights, np.nan).reshape(points.shape[:2])
    there = np.isfinite(heights)
    seen = there.sum(axis=1) >= 3
    start, end = _longest_piece(seen if shown is None else seen & shown(way), run)
    first, last = _firm(seen[start:end], there[start:end].mean(axis=1), heights[start:end], run)
    left_out = STEP * float(seen[run:].sum() - seen[max(run, start) : end].sum())
    first, last = start + first, start + last
    way, heights, seen = way[first:last], heights[first:last], seen[first:last]
    known = float(seen.mean()) if len(seen) else 0.0
    if known < _KNOWN:
        raise SceneError(
            f"{known:.0%} of the way has ground below it in the mesh",
            fix="photograph the ground too, from above, or set the waypoints on the label page",
        )
    if len(way) < _SHORTEST:
        raise _too_short(STEP * len(way))
    stations = STEP * np.arange(len(way), dtype=np.float64)
    filled = np.where(seen[:, None], heights, 0.0)
    middle = np.array([np.median(row[np.isfinite(row)]) for row in filled])
    lean = _lean(np.where(seen[:, None], heights, np.nan))
    height = np.interp(stations, stations[seen], middle[seen])
    lean = np.interp(stations, stations[seen], lean[seen])
    # Stairs and bars across the way are as high at the left as at the right; cobbles are not.
    off = filled - middle[:, None] - lean[:, None] * _SIDES
    rough = 1.4826 * float(np.median(np.abs(off[seen][:, _SIDES != 0.0])))
    return GroundProfile(
        xy=way,
        along=stations,
        height=_settled(height),
        lean=_settled(lean),
        known=known,
        edge=max(EDGE_RISE, _NOISE * rough),
        left_out=left_out,
    )


def _too_short(metres: float) -> SceneError:
    return SceneError(
        f"the longest strip of ground is {metres:.2f} m long, which is too short for a course",
        fix="photograph more of the ground, from above, or set the waypoints on the label page",
    )


def _longest_piece(seen: NDArray[np.bool_], run: int) -> tuple[int, int]:
    """Return first and end of the longest piece of a way between holes that are too long.

    It has up to `run` places without ground before its own.

    Args:
        seen: (S,) whether there is ground.
        run: places that were put before the way.
    """
    places = np.flatnonzero(seen)
    if not len(places):
        return 0, len(seen)
    pieces = np.split(places, np.flatnonzero(np.diff(places) * STEP > _LONGEST_HOLE) + 1)
    longest = max(pieces, key=len)
    return max(0, int(longest[0]) - run), int(longest[-1]) + 1


def sound(there: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return at which points (S,) of a way none of its lines has a hole that is wider than a foot.

    Args:
        there: (S, lines) whether there is ground, `STEP` apart along the way.
    """
    padded = np.pad(~there, ((2, 2), (0, 0)), mode="edge")
    three = padded[:-2] & padded[1:-1] & padded[2:]
    holes = three[:-2] | three[1:-1] | three[2:]
    return np.logical_not(np.logical_or.reduce(holes, axis=1))


def _firm(seen: NDArray[np.bool_], share: Values, heights: Values, run: int) -> tuple[int, int]:
    """Return the first place of a way where a robot can stand, and one past the last with ground.

    Not before the point `run`; without any, the whole way from there on. A robot that is set down
    needs ground under every foot: a point whose ground is whole is preferred to an earlier one, and
    one whose ground is even, a step farther, to that: what lies below the first camera was seen by
    none, and is filled as it may be.

    Args:
        seen: (S,) whether most lines have ground.
        share: (S,) of the lines that have.
        heights: (S, lines) metres, nan without ground.
        run: places that were put before the way.
    """
    half = round(_STAND / STEP / 2)
    about = np.lib.stride_tricks.sliding_window_view(
        np.pad(np.stack([seen, share]), ((0, 0), (half, half)), mode="edge"), 2 * half + 1, axis=1
    )[:, run:]
    firm = about[0].all(axis=1)
    places = np.flatnonzero(firm) + run
    if not len(places):
        return run, len(seen)
    whole = np.flatnonzero(firm & (about[1].mean(axis=1) >= _WHOLE)) + run
    first = int((whole if len(whole) else places)[0])
    even = whole[_even(heights, half)[whole] & (whole <= first + round(_STEP_ON / STEP))]
    return int(even[0]) if len(even) else first, int(places[-1]) + 1


def _even(heights: Values, half: int) -> NDArray[np.bool_]:
    """Return about which points (S,) the ground lies in a plane, level or not.

    On ground that is rough all along, these are the points where it is as even as it usually is.

    Args:
        heights: (S, lines) metres, nan without ground.
        half: places to each side that count.
    """
    padded = np.pad(heights, ((half, half), (0, 0)), mode="edge")
    about = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1, axis=0)
    ahead, left = np.meshgrid(STEP * np.arange(-half, half + 1), _SIDES)
    plane = np.stack([np.ones_like(ahead), ahead, left], axis=-1).reshape(-1, 3)
    values = about.reshape(len(heights), -1)
    known = np.where(np.isfinite(values), values, 0.0)
    off = np.abs(values - known @ np.linalg.pinv(plane).T @ plane.T)
    off = np.where(np.isfinite(off), off, np.inf)
    farthest = np.quantile(off, _WHOLE, axis=1, method="inverted_cdf")
    usual = farthest[np.isfinite(farthest)]
    return farthest <= max(_BUMP, _USUAL * float(np.median(usual)) if len(usual) else 0.0)


def _lean(heights: Values) -> Values:
    """Return the slope of heights (S, lines) to the left.

    By Theil and Sen: an edge beside the way is no slope.
    """
    first, second = np.triu_indices(len(_SIDES), 1)
    slopes = (heights[:, second] - heights[:, first]) / (_SIDES[second] - _SIDES[first])
    ordered = np.sort(slopes, axis=1)  # nan comes last.
    count = np.isfinite(slopes).sum(axis=1)
    rows = np.arange(len(heights))
    low, high = np.maximum(count - 1, 0) // 2, count // 2
    high = np.minimum(high, len(first) - 1)
    middle = (ordered[rows, low] + ordered[rows, high]) / 2
    return np.where((count > 0) & np.isfinite(middle), middle, 0.0)


def _settled(values: Values) -> Values:
    half = _MEDIAN // 2
    padded = np.pad(values, half, mode="edge")
    return np.median(np.lib.stride_tricks.sliding_window_view(padded, _MEDIAN), axis=1)


def way_of(centres: Values) -> Values:
    """Return the way there, (S, 2) metres, `STEP` apart: from the first camera to the walk's end.

    Who walked back took the same way twice; only the way there counts. So does it where somebody
    then went around the object, and half a step farther: the end is the farthest camera of the
    first time that the walk came near its greatest distance.

    Args:
        centres: (V, 3) of the cameras in the order of the walk, metres, z up.

    Raises:
        SceneError: the cameras went less than a metre.
    """
    flat = centres[:, :2]
    away = np.linalg.norm(flat - flat[:1], axis=1)
    if not len(flat) or away.max() < _LEAST:
        gone = float(away.max(initial=0.0))
        raise SceneError(
            f"the cameras went {gone:.2f} m from the first one, which is too short for a course",
            fix=f"photograph a walk of {_LEAST:g} m or more, or set the waypoints on the label "
            "page",
        )
    walked = _evenly(flat[: _end(away) + 1])
    half = max(1, round(_SMOOTH / STEP / 2))
    # The ends are mirrored at themselves, so that the way still begins and ends where it did.
    before, after = (
        2 * walked[0] - walked[half:0:-1],
        2 * walked[-1] - walked[-2 : -half - 2 : -1],
    )
    padded = np.concatenate([before, walked, after])
    sums = np.cumsum(np.concatenate([np.zeros((1, 2)), padded]), axis=0)
    width = 2 * half + 1
    return _evenly((sums[width:] - sums[:-width]) / width)


def free_ways(
    mesh: TriangleMesh, centres: Values, below: float, shown: Shown | None = None
) -> list[Values]:
    """Return the longest straight ways on level ground, (S, 2) metres, `STEP` apart.

    One for each heading at most, the longest one first.

    It is on the ground that the cameras walked on, see `walkable.py`. Ground as wide as a robot to
    each side of it differs in height by `_LEVEL` at most. Ways are looked for every 15 degrees on a
    grid of 0.1 m, coarser where the mesh is large.

    Args:
        mesh: in metres, z up.
        centres: (V, 3) of the cameras: of two ways along a strip, the one that they went.
        below: height from which to look down, metres.
        shown: where photographs show the ground; None if unknown.

    Raises:
        SceneError: there is no level ground as wide as a robot.
    """
    rays = RayScene(mesh)
    ground = walkable(mesh, rays)
    region = ground.walked(centres)
    if region is None:
        raise _no_level("a robot fits nowhere on it")
    low, high = mesh.vertices[:, :2].min(axis=0), mesh.vertices[:, :2].max(axis=0)
    cell = max(_FREE_CELL, float((high - low).max()) / _MOST_CELLS)
    shape = tuple(np.ceil((high - low) / cell).astype(int).tolist())
    middles = low + (np.indices(shape).reshape(2, -1).T + 0.5) * cell
    above = rays.height(middles, z_from=below)
    # Below a table a robot may fit, but no course is laid there.
    known = np.abs(ground.under(region, middles) - above) <= _LEVEL
    known &= np.ones(len(middles), dtype=np.bool_) if shown is None else shown(middles)
    heights = above.reshape(shape)
    reach = max(1, round(_STAND / 2 / cell))
    square = (2 * reach + 1, 2 * reach + 1)
    around = np.lib.stride_tricks.sliding_window_view(
        np.pad(heights, reach, constant_values=-np.inf), square
    )
    lowest, highest = around.min(axis=(2, 3)), around.max(axis=(2, 3))
    there = np.isfinite(lowest) & known.reshape(shape)
    level = there & (np.where(there, highest - np.where(there, lowest, 0.0), np.inf) <= _LEVEL)
    found: list[tuple[float, Values]] = []
    middle, size = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    stations = np.arange(-size, size + cell, cell)
    for turn in np.radians(np.arange(0.0, 180.0, 15.0)).tolist():
        ahead = np.array([np.cos(turn), np.sin(turn)])
        left = np.array([-ahead[1], ahead[0]])
        points = middle + stations[:, None, None] * left + stations[:, None] * ahead
        places = np.floor((points - low) / cell).astype(np.int64)
        inside = ((places >= 0) & (places < shape)).all(axis=-1)
        places = np.where(inside[..., None], places, 0)
        free = inside & level[places[..., 0], places[..., 1]]
        # A column of False between the lines ends each run.
        flat = np.pad(free, ((0, 0), (1, 1))).ravel().astype(np.int8)
        starts, stops = (np.flatnonzero(np.diff(flat) == way) for way in (1, -1))
        if len(starts):
            longest = int(np.argmax(stops - starts))
            row, column = divmod(int(starts[longest]), free.shape[1] + 2)
            last = column + int((stops - starts)[longest]) - 1
            ends = points[row, [column, last]]
            if (ends[1] - ends[0]) @ (centres[-1, :2] - centres[0, :2]) < 0.0:
                ends = ends[::-1]
            found.append((round(float((stops - starts)[longest]) * cell, 6), _evenly(ends)))
    if not found:
        places = ground.points[ground.region == region]
        far = np.full(len(places), np.inf)
        for centre in centres:
            far = np.minimum(far, np.linalg.norm(places - centre, axis=1))
        x, y, _ = places[int(far.argmin())].tolist()
        raise _no_level(
            f"a robot fits on {ground.areas[region]:.2f} m2 of it at most, {far.min():.1f} m from "
            f"the nearest camera, about ({x:.1f}, {y:.1f})"
        )
    return [way for _, way in sorted(found, key=lambda one: -one[0])]


def _no_level(why: str) -> SceneError:
    return SceneError(
        f"the mesh has no level ground {_STAND:g} m wide that photographs show: {why}",
        fix="photograph the ground too, from above, or set the waypoints on the label page",
    )


def _end(away: Values) -> int:
    """Return the camera at which the walk, at such distances from its first one, turned back."""
    near = away >= _FAR * away.max()
    first = int(np.argmax(near))
    back = np.flatnonzero(~near[first:])
    last = first + int(back[0]) if len(back) else len(away)
    return first + int(np.argmax(away[first:last]))


def _evenly(points: Values) -> Values:
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    stations = np.arange(0.0, along[-1] + 1e-9, STEP)
    return np.column_stack([np.interp(stations, along, axis) for axis in points.T])


@dataclass(frozen=True, kw_only=True)
class Stretch:
    """A piece of a profile. Lengths and heights in metres.

    Attributes:
        kind: `level`, a `slope` along the way, or an `edge` up or down.
        start, end: along the way.
        before, after: heights of the ground at the start and at the end.
    """

    kind: Literal["level", "slope", "edge"]
    start: float
    end: float
    before: float
    after: float

    @property
    def middle(self) -> float:
        """Along the way."""
        return (self.start + self.end) / 2

    @property
    def length(self) -> float:
        """Along the way."""
        return self.end - self.start

    @property
    def rise(self) -> float:
        """Below 0 where it leads down."""
        return self.after - self.before


def stretches_of(profile: GroundProfile) -> list[Stretch]:
    """Return the pieces of a profile in order: edges, and what lies between them.

    An edge rises or falls by the profile's `edge` at least within 8 cm, from the ground on one side
    to that on the other. Between edges, runs of 30 cm or more with a grade above 6 degrees are
    slopes and the rest is level.
    """
    z = profile.height
    stretches: list[Stretch] = []
    bounds = [0, *(place for edge in _edges(z, profile.edge) for place in edge), len(z) - 1]
    for number, (first, last) in enumerate(pairwise(bounds)):
        if number % 2:
            stretches.append(_stretch("edge", first, last, z))
        else:
            stretches += _between(first, last, z)
    return [_sharp(stretch, stretches, z) for stretch in stretches]


def _sharp(stretch: Stretch, all_of_them: Sequence[Stretch], z: Values) -> Stretch:
    """Return an edge as high as the level ground before and behind it says, where there is some."""
    if stretch.kind != "edge":
        return stretch
    before, after = stretch.before, stretch.after
    for level in all_of_them:
        first, last = round(level.start / STEP), round(level.end / STEP)
        if level.kind == "level" and level.end == stretch.start:
            before = float(np.median(z[max(first, last - _BESIDE) : last + 1]))
        elif level.kind == "level" and level.start == stretch.end:
            after = float(np.median(z[first : min(last, first + _BESIDE) + 1]))
    return replace(stretch, before=before, after=after)


def _edges(z: Values, least: float) -> list[tuple[int, int]]:
    """Return first and last samples of each edge that is so high at least, metres."""
    rise = z[_EDGE_RUN:] - z[:-_EDGE_RUN] if len(z) > _EDGE_RUN else np.zeros(0)
    steep = np.where(np.abs(rise) >= least, np.sign(rise), 0.0)
    edges: list[tuple[int, int]] = []
    for first, last in _runs(steep):
        # The windows that contain an edge reach beyond it; what moves in them is the edge.
        low, high = first, min(last + _EDGE_RUN, len(z) - 1)
        moves = np.flatnonzero(np.abs(np.diff(z[low : high + 1])) > 0.2 * least) + low
        if len(moves):
            low, high = int(moves[0]), int(moves[-1]) + 1
        if edges and low <= edges[-1][1]:
            low = edges[-1][1]
        if high > low:
            edges.append((low, high))
    return edges


def _between(first: int, last: int, z: Values) -> list[Stretch]:
    """Return slopes and level pieces between two edges."""
    piece = z[first : last + 1]
    half = _GRADE_RUN // 2
    if len(piece) <= 2 * half:
        return [_stretch("level", first, last, z)] if last > first else []
    places = np.arange(len(piece))
    low, high = np.maximum(places - half, 0), np.minimum(places + half, len(piece) - 1)
    grade = (piece[high] - piece[low]) / (STEP * (high - low))
    steep = np.where(np.abs(grade) >= _GRADE, np.sign(grade), 0.0)
    slopes = [(a + first, b + first) for a, b in _runs(steep) if STEP * (b - a) >= _LEAST_SLOPE]
    bounds = [first, *(place for slope in slopes for place in slope), last]
    stretches: list[Stretch] = []
    for number, (a, b) in enumerate(pairwise(bounds)):
        if number % 2:
            stretches.append(_stretch("slope", a, b, z))
        elif STEP * (b - a) >= _LEAST_LEVEL or not slopes:
            stretches.append(_stretch("level", a, b, z))
    return stretches


def _stretch(kind: Literal["level", "slope", "edge"], first: int, last: int, z: Values) -> Stretch:
    before, after = float(z[first]), float(z[last])
    if kind == "level":
        before = after = float(np.median(z[first : last + 1]))
    return Stretch(kind=kind, start=STEP * first, end=STEP * last, before=before, after=after)


def _runs(signs: Values) -> list[tuple[int, int]]:
    breaks = np.flatnonzero(np.diff(signs, prepend=0.0, append=0.0))
    return [(a, b - 1) for a, b in pairwise(breaks.tolist()) if signs[a] != 0]
