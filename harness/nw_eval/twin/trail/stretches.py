"""A profile in pieces: what is level, what slopes along the way, and edges between them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from nw_eval.twin.trail.ground import GroundProfile
from nw_eval.twin.trail.way import STEP

Values = NDArray[np.float64]

EDGE_RISE = 0.06
"""What is lower is no edge, metres."""
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

    An edge rises or falls by `EDGE_RISE` at least within 8 cm, from the ground on one side to that
    on the other. Between edges, runs of 30 cm or more
    with a grade above 6 degrees are slopes and the rest is level.
    """
    z = profile.height
    found: list[Stretch] = []
    bounds = [0, *(place for edge in _edges(z) for place in edge), len(z) - 1]
    for number, (first, last) in enumerate(pairwise(bounds)):
        if number % 2:
            found.append(_stretch("edge", first, last, z))
        else:
            found += _between(first, last, z)
    return [_sharp(stretch, found, z) for stretch in found]


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


def _edges(z: Values) -> list[tuple[int, int]]:
    """Return first and last samples of each edge."""
    rise = z[_EDGE_RUN:] - z[:-_EDGE_RUN] if len(z) > _EDGE_RUN else np.zeros(0)
    steep = np.where(np.abs(rise) >= EDGE_RISE, np.sign(rise), 0.0)
    edges: list[tuple[int, int]] = []
    for first, last in _runs(steep):
        # The windows that contain an edge reach beyond it; what moves in them is the edge.
        low, high = first, min(last + _EDGE_RUN, len(z) - 1)
        moves = np.flatnonzero(np.abs(np.diff(z[low : high + 1])) > 0.2 * EDGE_RISE) + low
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
    found: list[Stretch] = []
    for number, (a, b) in enumerate(pairwise(bounds)):
        if number % 2:
            found.append(_stretch("slope", a, b, z))
        elif STEP * (b - a) >= _LEAST_LEVEL or not slopes:
            found.append(_stretch("level", a, b, z))
    return found


def _stretch(kind: Literal["level", "slope", "edge"], first: int, last: int, z: Values) -> Stretch:
    before, after = float(z[first]), float(z[last])
    if kind == "level":
        before = after = float(np.median(z[first : last + 1]))
    return Stretch(kind=kind, start=STEP * first, end=STEP * last, before=before, after=after)


def _runs(signs: Values) -> list[tuple[int, int]]:
    """Return first and last places of each run of equal signs that are not 0."""
    breaks = np.flatnonzero(np.diff(signs, prepend=0.0, append=0.0))
    return [(a, b - 1) for a, b in pairwise(breaks.tolist()) if signs[a] != 0]
