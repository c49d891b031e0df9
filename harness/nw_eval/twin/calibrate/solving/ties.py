"""Cameras that common points tie together: what none ties to the rest may lie anywhere."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from itertools import combinations

import numpy as np

from nw_eval.twin.calibrate.solution import Solution

_SHARED = 25
"""Points that two cameras must both see to be tied. Of 240 cameras of six built-in courses the one
that was placed wrongly, by metres, shared 17 with another one, the others 37 and more."""


def tied(solution: Solution) -> Solution:
    """Return the largest part of a solution whose cameras hang together, with the points it sees.

    Global mapping places all cameras of its graph of turns, also a group of them that shares no
    point with the others: where it lies, and how large it is, is then chance.
    """
    part = _largest(solution)
    placed = [solution.placed[place] for place in part]
    if len(placed) == len(solution.placed):
        return solution
    seen = [one.seen for one in placed]
    kept = np.unique(np.concatenate(seen)) if seen else np.zeros(0, np.int32)
    renumbered = np.zeros(len(solution.points), np.int32)
    renumbered[kept] = np.arange(len(kept), dtype=np.int32)
    return Solution(
        placed=tuple(replace(one, seen=renumbered[one.seen]) for one in placed),
        points=solution.points[kept],
        colours=solution.colours[kept],
        errors=solution.errors[kept],
    )


def _largest(solution: Solution) -> list[int]:
    """Return the places of the cameras of the largest part, in order; of equals the first."""
    parts = list(range(len(solution.placed)))
    for (one, other), count in sorted(_shared(solution).items()):
        if count >= _SHARED and parts[one] != parts[other]:
            old, new = parts[other], parts[one]
            parts = [new if part == old else part for part in parts]
    sizes = Counter(parts)
    largest = max(parts, key=lambda part: (sizes[part], -parts.index(part)), default=None)
    return [place for place, part in enumerate(parts) if part == largest]


def _shared(solution: Solution) -> Counter[tuple[int, int]]:
    """Return how many points two cameras both see, by their places."""
    watching: list[list[int]] = [[] for _ in range(len(solution.points))]
    for place, one in enumerate(solution.placed):
        for point in one.seen.tolist():
            watching[point].append(place)
    return Counter(pair for places in watching for pair in combinations(places, 2))
