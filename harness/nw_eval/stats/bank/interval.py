"""Which drops the rounds so far do not rule out.

A drop is ruled out as too small where E_regr, as evidence against "the drop is at most this", has
reached 1 / alpha_regr, and as too large where E_pass against "the drop is at least this" has
reached 1 / alpha_pass. E_regr falls and E_pass rises with the drop that is asked about, so that
what is not ruled out is an interval, and each end is found by search. PASS is a high end below
max_drop, REGRESSED a low end above `tolerate`: interval and verdict cannot contradict each other.

The true drop is one of the nulls. By Ville's inequality its evidence ever reaches 1 / alpha with
probability at most alpha, so that over all rounds together the low end is above the true drop with
probability at most alpha_regr, and the high end below it with at most alpha_pass: one may look
after every round, and stop when one likes.

Source: I. Waudby-Smith and A. Ramdas, "Confidence sequences for sampling without replacement",
NeurIPS 33 (2020), arXiv 2006.04347, section 2; J. Ville, "Etude critique de la notion de collectif"
(1939).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from nw_eval.stats.bank.decide import Truths
from nw_eval.stats.bank.evidence import (
    Gamblers,
    above,
    after_each,
    against_at_least,
    against_at_most,
    below,
    mean_of,
)
from nw_eval.stats.bank.panel import Bank, Floats
from nw_eval.stats.interval import Interval

_PARTS, _TIMES = 32, 6
"""Of how many parts each search keeps one, and how often: to 2 / 32^6, under 1e-8."""


def drop_interval(
    bank: Bank,
    candidate: Floats,
    baseline: Floats,
    *,
    alpha_pass: float = 0.05,
    alpha_regr: float = 0.01,
) -> Interval:
    """Return the drops of mean success that are not ruled out after R rounds.

    Args:
        bank: of the baseline, without leading axes.
        candidate: c in the order drawn, shape (R, S); NaN, a trial without a result, counts as 0
            for the high end and as 1 for the low one.
        baseline: b of the same starts, shape (R, S).
        alpha_pass: probability, at most, that the high end is below the true drop.
        alpha_regr: probability, at most, that the low end is above it.

    Returns:
        An interval within B - 1 to B, all of it without rounds. Where the ends cross, as they do in
        hardly any random order, they change places, which makes neither err more often.

    Raises:
        ValueError: there are more rounds than starts.
    """
    missing = np.isnan(candidate)
    worst, best = np.where(missing, 0.0, candidate), np.where(missing, 1.0, candidate)
    ups = [above(bank, c, b) for c, b in zip(worst, baseline, strict=True)]
    downs = [below(bank, c, b) for c, b in zip(best, baseline, strict=True)]
    least, most = float(bank.mean[0]) - 1.0, float(bank.mean[0])

    def too_small(drops: Floats) -> Truths:
        return _after_all(against_at_most(bank, drops), downs) >= 1.0 / alpha_regr

    def too_large(drops: Floats) -> Truths:
        return _after_all(against_at_least(bank, drops), ups) >= 1.0 / alpha_pass

    ends = _first(lambda drops: ~too_small(drops), least, most), _first(too_large, least, most)
    return Interval(min(ends), max(ends))


def _after_all(gamblers: Gamblers, rounds: Sequence[Sequence[Floats]]) -> Floats:
    for values in rounds:
        gamblers = after_each(gamblers, values)
    return mean_of(gamblers)


def _first(holds: Callable[[Floats], Truths], low: float, high: float) -> float:
    """Return where something begins to hold, that then goes on to hold; `high` if nowhere."""
    for _ in range(_TIMES):
        points = np.linspace(low, high, _PARTS + 1)
        found = np.flatnonzero(holds(points))
        if not found.size:
            return high
        if found[0] == 0:
            return low
        low, high = float(points[found[0] - 1]), float(points[found[0]])
    return high
