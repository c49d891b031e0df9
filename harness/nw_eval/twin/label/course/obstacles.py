"""What a height profile asks of legs: hurdles, gaps, steps and ramps."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from nw_eval.twin.label.course.profile import SPACING, HeightProfile

ObstacleKind = Literal["hurdle", "gap", "step", "ramp"]

_WINDOW = 5  # samples, 0.1 m: over less, a scan's edge is not all there
_SUDDEN = 0.08  # m in a window; steeper than any ramp that is walked
_SLOPE_WINDOW = 15  # samples, 0.3 m: about a robot's stance
_FLAT = math.radians(10)
_LONGEST_HURDLE, _LONGEST_GAP = 0.6, 1.2  # m; longer ones are steps up and down
_LEAST_GAP = 0.25  # m deep; into less the robot steps down
_BOTTOMLESS = 1.0  # m below all ground that there is


@dataclass(frozen=True, kw_only=True)
class Obstacle:
    """One thing on the way.

    Attributes:
        kind: a `step` goes up or down; a `ramp` too.
        at: distance from the start to its near edge, m.
        size: height of a hurdle, width of a gap, height of a step, m; angle of a ramp, rad.
    """

    kind: ObstacleKind
    at: float
    size: float


def obstacles_of(profile: HeightProfile) -> tuple[Obstacle, ...]:
    """Return the obstacles along a profile, in order."""
    if not np.isfinite(profile.height).any() or profile.distance[-1] < 2 * SPACING:
        return ()
    at = np.arange(0.0, profile.distance[-1], SPACING)
    floor = profile.height[np.isfinite(profile.height)].min() - _BOTTOMLESS
    height = np.interp(at, profile.distance, np.maximum(profile.height, floor))
    if len(at) <= _WINDOW:
        return ()
    rise = height[_WINDOW:] - height[:-_WINDOW]
    sign = np.where(np.abs(rise) > _SUDDEN, np.sign(rise), 0.0)
    edges: list[tuple[float, float]] = []
    for first, last in _runs(sign):
        within = height[first : last + _WINDOW + 1]
        steepest = int((sign[first] * np.diff(within)).argmax())
        edges.append((float(at[first + steepest]), float(within[-1] - within[0])))
    found = [*_paired(edges), *_ramps(at, height, sign != 0)]
    return tuple(sorted(found, key=lambda obstacle: obstacle.at))


def _runs(sign: NDArray[np.float64]) -> list[tuple[int, int]]:
    """Return first and last index of each run of one sign that is not 0."""
    borders = np.flatnonzero(np.diff(np.concatenate([[0.0], sign, [0.0]])))
    return [
        (int(first), int(last) - 1)
        for first, last in pairwise(borders.tolist())
        if sign[first] != 0
    ]


def _paired(edges: list[tuple[float, float]]) -> list[Obstacle]:
    """Return obstacles of edges (distance, rise): up and down is a hurdle, down and up a gap."""
    found: list[Obstacle] = []
    i = 0
    while i < len(edges):
        at, rise = edges[i]
        after, back = edges[i + 1] if i + 1 < len(edges) else (math.inf, 0.0)
        width = after - at
        if rise > 0 > back and width <= _LONGEST_HURDLE and -back > rise / 2:
            found.append(Obstacle(kind="hurdle", at=at, size=rise))
            i += 2
        elif rise < 0 < back and width <= _LONGEST_GAP and min(-rise, back) >= _LEAST_GAP:
            found.append(Obstacle(kind="gap", at=at, size=width))
            i += 2
        else:
            found.append(Obstacle(kind="step", at=at, size=abs(rise)))
            i += 1
    return found


def _ramps(
    at: NDArray[np.float64], height: NDArray[np.float64], sudden: NDArray[np.bool_]
) -> list[Obstacle]:
    count = len(at) - _SLOPE_WINDOW
    if count <= 0:
        return []
    slope = (height[_SLOPE_WINDOW:] - height[:-_SLOPE_WINDOW]) / (_SLOPE_WINDOW * SPACING)
    # An edge within the window, or just beside it, is no slope.
    near = np.convolve(sudden, np.ones(_SLOPE_WINDOW + _WINDOW), "full")
    near = near[_SLOPE_WINDOW : _SLOPE_WINDOW + count] > 0
    steep = np.where(~near & (np.abs(slope) > math.tan(_FLAT)), np.sign(slope), 0.0)
    return [
        Obstacle(
            kind="ramp",
            at=float(at[first]),
            size=math.atan(float(np.abs(slope[first : last + 1]).max())),
        )
        for first, last in _runs(steep)
    ]
