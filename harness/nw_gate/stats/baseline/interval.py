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

**Bets that learn.** Fixed bets suit success, which is all or nothing in many trials. A score whose
trials scatter by a few percent of its range allows far larger bets, and how large shows in the
trials before. So half of the capital may bet, against a mean of at most n, the share

    l_t = min(d_t / (v_t + d_t^2), c / n),  d_t = max(m_t - n, 0),  c in {.3, .9, .99},

where m_t and v_t are mean and variance of the values before t, with one value n and a standard
deviation of .04 before the first. Given the past l_t is fixed, and each value has at most the
expectation n where scene and start are drawn at random, so that the capital
prod_t (1 + l_t (y_t - n)) is a supermartingale under the null, as that of fixed bets is.

Source: I. Waudby-Smith and A. Ramdas, "Confidence sequences for sampling without replacement",
NeurIPS 33 (2020), arXiv 2006.04347, section 2; J. Ville, "Etude critique de la notion de collectif"
(1939); for bets that learn I. Waudby-Smith and A. Ramdas, "Estimating means of bounded random
variables by betting", JRSS B 86 (2024), appendix B.3 (aGRAPA).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import inf

import numpy as np

from nw_gate.stats.baseline.evidence import (
    DOWN,
    UP,
    Bets,
    Floats,
    Places,
    Reference,
    Truths,
    capital,
    nulls_at_least,
    nulls_at_most,
)
from nw_gate.stats.baseline.trials import DrawnTrials, above_at, below_at
from nw_gate.stats.interval import Interval

_PARTS, _TIMES = 32, 6
"""Of how many parts each search keeps one, and how often: to 2 / 32^6, under 1e-8."""

_TIMES_ALONE = 3
"""For scenes alone, of which there may be many: to 2 / 32^3, under 1e-4."""


def drop_interval_after(
    reference: Reference,
    trials: DrawnTrials,
    *,
    alpha_pass: float = 0.05,
    alpha_regr: float = 0.01,
    learns: bool = False,
) -> Interval:
    """Return the drops of mean success that are not ruled out after T trials of the random order.

    Args:
        reference: a baseline or `Reference.control`, without leading axes.
        trials: those that the evidence on the mean rests on, shape (T,).
        alpha_pass: probability, at most, that the high end is below the true drop.
        alpha_regr: probability, at most, that the low end is above it.
        learns: whether half of the capital bets by what the trials before show: for scores, of a
            baseline without an end (`Reference.fresh`, or a control). With another one none does.

    Returns:
        An interval within B - 1 to B, or -1 to 1 beside a control; all of it without trials. Where
        the ends cross, as they do in hardly any random order, they change positions, which makes
        neither err more often.

    Raises:
        ValueError: there are more trials than pairs of a scene and a start.
    """
    learns = learns and reference.starts == inf
    return _interval(reference, trials, (alpha_pass, alpha_regr), _TIMES, learns=learns)


def scene_drop_intervals(
    reference: Reference, trials: DrawnTrials, *, alpha_pass: float = 0.05, alpha_regr: float = 0.01
) -> tuple[Interval, ...]:
    """Return for each scene the drops in it that its own trials do not rule out.

    Each is the interval of `drop_interval_after` for a baseline of that scene alone, to 1e-4: not
    corrected for the number of scenes. How many trials a scene has may depend on the results of
    those before.

    Args:
        reference: as for `drop_interval_after`.
        trials: of all scenes, in the order drawn, shape (T,).
        alpha_pass: for each scene.
        alpha_regr: for each scene.

    Raises:
        ValueError: a scene has more trials than starts.
    """
    intervals: list[Interval] = []
    for scene in range(len(reference.means)):
        own = trials.at(np.flatnonzero(trials.scenes == scene).tolist())
        intervals.append(
            _interval(
                replace(reference, means=reference.means[[scene]], bets=None),
                replace(own, scenes=np.zeros_like(own.scenes)),
                (alpha_pass, alpha_regr),
                _TIMES_ALONE,
            )
        )
    return tuple(intervals)


def _interval(
    reference: Reference,
    trials: DrawnTrials,
    alphas: tuple[float, float],
    times: int,
    *,
    learns: bool = False,
) -> Interval:
    """Return the drops that are not ruled out; `times` is how often a search keeps one part."""
    high = 1.0 if reference.paired else float(reference.mean[0])
    low = -1.0 if reference.paired else high - 1.0
    if not len(trials.scenes):
        return Interval(low, high)
    too_small, too_large = _ruled_out(reference, trials, alphas, learns=learns)
    ends = [
        float(_first(holds, np.array([low]), np.array([high]), times)[0])
        for holds in (lambda drops: ~too_small(drops), too_large)
    ]
    return Interval(min(ends), max(ends))


def drops_ruled_out(
    reference: Reference,
    trials: DrawnTrials,
    drops: tuple[float, float],
    *,
    alpha_pass: float,
    alpha_regr: float,
    learns: bool = False,
) -> tuple[bool, bool]:
    """Return whether a drop is ruled out as too small, and another one as too large.

    That is where they lie beside the interval of `drop_interval_after`, of which the other
    arguments are, and takes a hundredth of its time.
    """
    too_small, too_large = _ruled_out(
        reference, trials, (alpha_pass, alpha_regr), learns=learns and reference.starts == inf
    )
    small, large = (np.array([[drop]]) for drop in drops)
    return bool(too_small(small)[0, 0]), bool(too_large(large)[0, 0])


def _ruled_out(
    reference: Reference, trials: DrawnTrials, alphas: tuple[float, float], *, learns: bool
) -> tuple[Callable[[Floats], Truths], Callable[[Floats], Truths]]:
    """Return what says of drops whether they are ruled out as too small, and as too large."""
    ups, downs = above_at(reference, trials.counted(0.0)), below_at(reference, trials.counted(1.0))
    alpha_pass, alpha_regr = alphas

    def last(values: list[Floats], nulls: list[Floats], bets: Bets) -> Floats:
        capitals = capital(reference, values, nulls, bets)[..., -1]
        if not learns:
            return capitals
        learnt = [_learnt(y, null) for y, null in zip(values, nulls, strict=True)]
        return (capitals + np.mean(learnt, axis=0)) / 2.0

    def too_small(drops: Floats) -> Truths:
        return last(downs, nulls_at_most(reference, drops), DOWN) >= 1.0 / alpha_regr

    def too_large(drops: Floats) -> Truths:
        return last(ups, nulls_at_least(reference, drops), UP) >= 1.0 / alpha_pass

    return too_small, too_large


_CAPS, _SHARES = (0.3, 0.9, 0.99), (0.25, 0.5, 0.25)
"""Of the largest bet that cannot go bankrupt, and of the capital that bets so at most."""
_PRIOR = 0.04**2
"""Variance of values before the first trial."""
_LEAST, _MOST = 1e-6, 1e150


def _learnt(values: Floats, nulls: Floats) -> Floats:
    """Return the capital, against each null, of a bettor who learns from the values before.

    Args:
        values: y in the order drawn, shape (T,).
        nulls: n, any shape.

    Returns:
        Of the shape of the nulls, after the last value.
    """
    null = np.maximum(nulls, _LEAST)
    capital = [np.ones_like(null) for _ in _CAPS]
    total = squares = 0.0
    for count, value in enumerate(values.tolist(), start=1):
        edge = np.maximum((null + total) / count - null, 0.0)
        wanted = edge / ((_PRIOR + squares) / count + edge * edge)
        for which, cap in enumerate(_CAPS):
            won = 1.0 + np.minimum(wanted, cap / null) * (value - null)
            capital[which] = np.minimum(capital[which] * won, _MOST)
        total += value
        squares += (value - total / count) ** 2
    return sum((s * each for s, each in zip(_SHARES, capital, strict=True)), np.zeros_like(null))


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
        held = holds(points)
        first = held.argmax(axis=-1)  # 0 where it holds nowhere, too.
        last = np.where(held.any(axis=-1), first, _PARTS)
        begins = held[:, 0]
        high = np.where(begins, low, _at(points, last))
        low = np.where(begins | ~held.any(axis=-1), high, _at(points, last - 1))
    return high


def _at(points: Floats, places: Places) -> Floats:
    return np.take_along_axis(points, places[:, None], axis=-1)[:, 0]
