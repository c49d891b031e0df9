"""What choosing the best of many does: it shows more than it is, and one passes that should not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nw_eval.stats.courses import SceneCounts
from nw_eval.stats.foresight import RUNS, runs_at


@dataclass(frozen=True, kw_only=True)
class Luck:
    """What chance alone does for the best of some candidates of which none is better."""

    overstated: float
    """Mean over simulations of how much more the best shows than all truly are."""
    any_passes: float | None
    """Share of simulations in which at least one passes the bar; None without a bar."""


def luck_of_the_best(
    candidates: Sequence[list[SceneCounts]],
    truth: float,
    *,
    bar: float | None = None,
    confidence: float = 0.95,
) -> Luck:
    """Simulate candidates that are all equally good, each with as many trials as it had.

    Method: gate.md, "The absolute bar": with 50 checkpoints truly at the bar at least one passes in
    11 to 14 %, and the winner overstates by .04 to .06.

    Args:
        candidates: what was seen of each, by scene; scenes keep their relative difficulty.
        truth: the mean success of all of them, between 0 and 1.
        bar: what the lower bound of mean success must reach to pass.
        confidence: of that bound.

    Raises:
        ValueError: there are no candidates, or the truth is none.
    """
    if not candidates:
        raise ValueError("the best of no candidates")
    best, any_passes = np.zeros(RUNS), np.zeros(RUNS, dtype=bool)
    for stream, courses in enumerate(candidates, start=1):
        shown, passed = runs_at(courses, truth, stream=stream, bar=bar, confidence=confidence)
        best, any_passes = np.maximum(best, shown), any_passes | passed
    return Luck(
        overstated=float(best.mean()) - truth,
        any_passes=None if bar is None else float(any_passes.mean()),
    )
