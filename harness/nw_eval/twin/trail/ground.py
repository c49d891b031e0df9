"""The ground along a way: how high it is, and how it leans to the sides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import SceneError
from nw_eval.scenes.mesh import TriangleMesh
from nw_eval.scenes.rays import RayScene
from nw_eval.twin.trail.way import STEP

Values = NDArray[np.float64]

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
"""Distance from a plane up to which ground is even, metres."""
_MEDIAN = 5
"""Samples of which the middle one counts: scans have spikes."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GroundProfile:
    """The ground along a way, sample by sample.

    Attributes:
        xy: (S, 2) of the way, metres.
        along: (S,) metres from its start.
        height: (S,) metres; across holes of the mesh, straight.
        lean: (S,) slope to the left, tangent; positive where the left is higher.
        known: share of the samples that have ground below them.
    """

    xy: Values
    along: Values
    height: Values
    lean: Values
    known: float

    def after(self, start: float) -> GroundProfile:
        """Return the rest of it, from so many metres along."""
        first = round(start / STEP)
        return GroundProfile(
            xy=self.xy[first:],
            along=self.along[first:] - self.along[first],
            height=self.height[first:],
            lean=self.lean[first:],
            known=self.known,
        )


def ground_along(mesh: TriangleMesh, way: Values, below: float) -> GroundProfile:
    """Return the ground along a way.

    Args:
        mesh: in metres, z up, faces counter-clockwise from outside.
        way: (S, 2) metres, evenly spaced.
        below: height from which to look down, metres: that of the cameras, under any ceiling.

    Raises:
        SceneError: less than half of the way has ground below it.

    The way begins and ends where there is ground to stand on: cameras look ahead, and rarely at
    what lies below the first of them.
    """
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
    first, last = _firm(seen, there.mean(axis=1), heights, run)
    way, heights, seen = way[first:last], heights[first:last], seen[first:last]
    known = float(seen.mean()) if len(seen) else 0.0
    if known < _KNOWN:
        raise SceneError(
            f"{known:.0%} of the way has ground below it in the mesh",
            fix="photograph the ground too, from above, or write the trail by hand",
        )
    stations = STEP * np.arange(len(way), dtype=np.float64)
    filled = np.where(seen[:, None], heights, 0.0)
    middle = np.array([np.median(row[np.isfinite(row)]) for row in filled])
    lean = _lean(np.where(seen[:, None], heights, np.nan))
    height = np.interp(stations, stations[seen], middle[seen])
    lean = np.interp(stations, stations[seen], lean[seen])
    return GroundProfile(
        xy=way, along=stations, height=_settled(height), lean=_settled(lean), known=known
    )


def _firm(seen: NDArray[np.bool_], share: Values, heights: Values, run: int) -> tuple[int, int]:
    """Return the first place of a way where a robot can stand, and one past the last with ground.

    Not before the place `run`; without any, the whole way from there on. A robot that is set down
    needs ground under every foot: a place whose ground is whole is preferred to an earlier one, and
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
    """Return about which places (S,) the ground lies in a plane, level or not.

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
    return (off <= _BUMP).mean(axis=1) >= _WHOLE


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
    """Return the running median."""
    half = _MEDIAN // 2
    padded = np.pad(values, half, mode="edge")
    return np.median(np.lib.stride_tricks.sliding_window_view(padded, _MEDIAN), axis=1)
