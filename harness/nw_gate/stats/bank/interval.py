"""Which drops the trials so far do not rule out.

A drop is ruled out as too small where E_regr, as evidence against "the drop is at most this", has
reached 1 / alpha_regr, and as too large where E_pass against "the drop is at least this" has
reached 1 / alpha_pass. E_regr falls and E_pass rises with the drop that is asked about, so that
what is not ruled out is an interval, and each end is found by search. PASS is a high end below
max_drop, REGRESSED a low end above `tolerate`: interval and verdict cannot contradict each other.

The true drop is one of the nulls. By Ville's inequality its evidence ever reaches 1 / alpha with
probability at most alpha, so that over all trials together the low end is above the true drop with
probability at most alpha_regr, and the high end below it with at most alpha_pass: one may look
after every trial, and stop when one likes.

Source: I. Waudby-Smith and A. Ramdas, "Confidence sequences for sampling without replacement",
NeurIPS 33 (2020), arXiv 2006.04347, section 2; J. Ville, "Etude critique de la notion de collectif"
(1939).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from nw_gate.stats.bank.evidence import (
    DOWN,
    UP,
    Bank,
    Bets,
    Floats,
    Places,
    Truths,
    along,
    nulls_at_least,
    nulls_at_most,
)
from nw_gate.stats.bank.trials import DrawnTrials, above_at, below_at
from nw_gate.stats.interval import Interval

_PARTS, _TIMES = 32, 6
"""Of how many parts each search keeps one, and how often: to 2 / 32^6, under 1e-8."""

_TIMES_ALONE = 3
"""For scenes alone, of which there may be many: to 2 / 32^3, under 1e-4."""


def drop_interval_after(
    bank: Bank, trials: DrawnTrials, *, alpha_pass: float = 0.05, alpha_regr: float = 0.01
) -> Interval:
    """Return the drops of mean success that are not ruled out after T trials of the random order.

    Args:
        bank: of the baseline, or `Bank.control`, without leading axes.
        trials: those that the evidence on the mean rests on, shape (T,).
        alpha_pass: probability, at most, that the high end is below the true drop.
        alpha_regr: probability, at most, that the low end is above it.

    Returns:
        An interval within B - 1 to B, or -1 to 1 beside a control; all of it without trials. Where
        the ends cross, as they do in hardly any random order, they change positions, which makes
        neither err more often.

    Raises:
        ValueError: there are more trials than pairs of a scene and a start.
    """
    return _interval(bank, trials, (alpha_pass, alpha_regr), _TIMES)


def scene_drop_intervals(
    bank: Bank, trials: DrawnTrials, *, alpha_pass: float = 0.05, alpha_regr: float = 0.01
) -> tuple[Interval, ...]:
    """Return for each scene the drops in it that its own trials do not rule out.

    Each is the interval of `drop_interval_after` for a baseline of that scene alone, to 1e-4: not
    corrected for the number of scenes. How many trials a scene has may depend on the results of
    those before.

    Args:
        bank: as for `drop_interval_after`.
        trials: of all scenes, in the order drawn, shape (T,).
        alpha_pass: for each scene.
        alpha_regr: for each scene.

    Raises:
        ValueError: a scene has more trials than starts.
    """
    found: list[Interval] = []
    for scene in range(len(bank.means)):
        own = trials.at(np.flatnonzero(trials.scenes == scene).tolist())
        found.append(
            _interval(
                replace(bank, means=bank.means[[scene]]),
                replace(own, scenes=np.zeros_like(own.scenes)),
                (alpha_pass, alpha_regr),
                _TIMES_ALONE,
            )
        )
    return tuple(found)


def _interval(bank: Bank, trials: DrawnTrials, alphas: tuple[float, float], times: int) -> Interval:
    """Return the drops that are not ruled out; `times` is how often a search keeps one part."""
    high = 1.0 if bank.paired else float(bank.mean[0])
    low = -1.0 if bank.paired else high - 1.0
    if not len(trials.scenes):
        return Interval(low, high)
    ups, downs = above_at(bank, trials.counted(0.0)), below_at(bank, trials.counted(1.0))
    pairs = bank.starts * len(bank.means)
    alpha_pass, alpha_regr = alphas

    def last(values: list[Floats], nulls: list[Floats], bets: Bets) -> Floats:
        each = [
            along(np.broadcast_to(y, (*null.shape, len(y))), null, pairs, bets)[..., -1]
            for y, null in zip(values, nulls, strict=True)
        ]
        return np.mean(each, axis=0)

    def not_too_small(drops: Floats) -> Truths:
        return ~(last(downs, nulls_at_most(bank, drops), DOWN) >= 1.0 / alpha_regr)

    def too_large(drops: Floats) -> Truths:
        return last(ups, nulls_at_least(bank, drops), UP) >= 1.0 / alpha_pass

    ends = [
        float(_first(holds, np.array([low]), np.array([high]), times)[0])
        for holds in (not_too_small, too_large)
    ]
    return Interval(min(ends), max(ends))


def _first(holds: Callable[[Floats], Truths], low: Floats, high: Floats, times: int) -> Floats:
    """Return where something begins to hold, that then goes on to hold; `high` if nowhere.

    Args:
        holds: of drops of shape (G, P).
        low: shape (G,).
        high: shape (G,).
        times: how often one of the parts is kept.
    """
    for _ in range(times):
        points = np.linspace(low, high, _PARTS + 1, axis=-1)
        found = holds(points)
        first = found.argmax(axis=-1)  # 0 where it holds nowhere, too.
        last = np.where(found.any(axis=-1), first, _PARTS)
        begins = found[:, 0]
        high = np.where(begins, low, _at(points, last))
        low = np.where(begins | ~found.any(axis=-1), high, _at(points, last - 1))
    return high


def _at(points: Floats, places: Places) -> Floats:
    return np.take_along_axis(points, places[:, None], axis=-1)[:, 0]
