"""Finds the last of many moments from which something can still be done."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

COARSE = 8
"""Intervals into which the moments are divided first."""


def search(moments: Sequence[int], holds: Callable[[int], bool]) -> dict[int, bool]:
    """Try some of many moments, so that the last one at which something holds is among them.

    First as many as divide all of them evenly, whatever comes of it; then by bisection between the
    last of these at which it holds and the next. It need not hold at all moments before: of what
    lies between two that were tried, nothing is known.

    Args:
        moments: in their order, at least one.
        holds: whether it does at a moment.

    Returns:
        What was tried, in the order of the moments, and whether it held.
    """
    last = len(moments) - 1
    grid = np.unique(np.linspace(0, last, COARSE + 1).round().astype(int)).tolist()
    tried = {place: holds(moments[place]) for place in grid}
    held = [place for place in grid if tried[place]]
    if held and held[-1] != last:
        low = held[-1]
        high = grid[grid.index(low) + 1]
        while high - low > 1:
            middle = (low + high) // 2
            tried[middle] = holds(moments[middle])
            low, high = (middle, high) if tried[middle] else (low, middle)
    return {moments[place]: tried[place] for place in sorted(tried)}


def most_tries(count: int) -> int:
    """Return how many of `count` moments `search` tries at most."""
    return min(count, COARSE + 1 + max(0, int(np.ceil(np.log2(max(1.0, count / COARSE))))))
