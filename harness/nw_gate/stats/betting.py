"""Bounds on the mean success of a suite, valid at any number of trials and for any distribution.

The evidence against "mean success is at most m" is the capital of a bettor who may bet on every
trial, at odds that are fair if the claim is true. Over trials x_1 .. x_N, each within [0, 1],

    E(m) = sum_k p_k  prod_i (1 + b_k (x_i / m - 1)),     sum_k p_k = 1,  0 < b_k < 1,

has expectation at most 1 under the claim, so E(m) >= 1/alpha happens with probability at most
alpha (Markov). Every m that is so refuted lies below the bound. E falls with m: one root gives it.

Bets are fixed beforehand, not learnt from the data, because the scenes of a suite differ in
difficulty. For fixed b the product's expectation is prod_i (1 + b (mu_i / m - 1)), and by the
inequality of arithmetic and geometric means that is at most (1 + b (mu / m - 1))^N <= 1, where mu
is the mean of the mu_i: no trial needs the same distribution as another. Capital after whole rounds
(one more trial in every scene) is a supermartingale, so one may look, run more rounds, and look
again. The price of that freedom is width: for 81 of 90 successes the 95 % bound is 0.79, where
Clopper and Pearson's, for one look at equal trials, is 0.83.

Source: I. Waudby-Smith and A. Ramdas, "Estimating means of bounded random variables by betting",
JRSS B 86 (2024), sections 3 and 4; the step for unequal means is the inequality above.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, log
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_base import same_bits
from nw_gate.stats.interval import check_confidence

Groups = Sequence[NDArray[np.float64]]

# Shares of the largest bet that cannot go bankrupt, and their weights. The best share falls from 1
# for perfect scores to about 0.1 for 500 mixed ones. More shares than these tighten nothing: a
# finer grid pays in weight what it gains in fit (0.017 in the bound of 90 trials either way).
_BETS = np.array([0.1, 0.25, 0.5, 0.75, 0.99])
_LOG_WEIGHTS = same_bits.log(np.array([1.0, 2.0, 2.0, 1.0, 2.0]) / 8.0)
_HALVINGS = 60  # Of [0, 1]: beyond the precision of a double.
_AT_ONCE = 5  # Halvings whose points are looked at together, which takes less time, of:
_FEW = 1000  # different values at most.


def lower_bound(groups: Groups, confidence: float = 0.95) -> float:
    """Return a one-sided lower confidence bound of the mean, groups weighted equally.

    Args:
        groups: one array of values within [0, 1] for each scene, of any lengths.
        confidence: probability, at least, that the bound is below the true mean.

    Returns:
        A number from 0 to the observed mean. Without values it is 0.

    Raises:
        ValueError: values lie outside [0, 1] or the confidence outside (0, 1).
    """
    check_confidence(confidence)
    values, shares, counts = _weighted(groups)
    if values.size == 0 or not values.any():
        return 0.0
    threshold = -log(1.0 - confidence)
    low, halvings = 0.0, _AT_ONCE if values.size <= _FEW else 1
    parts = 2**halvings
    for number in range(1, _HALVINGS // halvings + 1):
        points = low + np.arange(1, parts) / float(parts) ** number
        refuted = _log_capital(values, shares, counts, points[:, None, None]) >= threshold
        low = float(points[refuted][-1]) if refuted.any() else low
    return low


def upper_bound(groups: Groups, confidence: float = 0.95) -> float:
    """Return a one-sided upper confidence bound of the mean: `lower_bound` of the failures."""
    failures = [1.0 - np.asarray(group, dtype=np.float64) for group in groups]
    return 1.0 - lower_bound(failures, confidence)


def evidence_above(groups: Groups, mean: float) -> float:
    """Return the e-value against "the true mean is at most `mean`"; 20 refutes it at 95 %."""
    values, shares, counts = _weighted(groups)
    if values.size == 0:
        return 1.0
    power = float(_log_capital(values, shares, counts, mean))
    return float(same_bits.exp(np.array(power))) if power < 700.0 else inf


def p_above(groups: Groups, mean: float) -> float:
    """Return a p-value against "the true mean is at most `mean`": 1 / E, by Markov's inequality.

    Args:
        groups: as for `lower_bound`.
        mean: of the claim, between 0 and 1.

    Raises:
        ValueError: values lie outside [0, 1].
    """
    return 1.0 / max(1.0, evidence_above(groups, mean))


def trials_to_certify(bar: float, confidence: float = 0.95) -> int:
    """Return the fewest trials, all perfect, that lift the lower bound to the bar."""
    check_confidence(confidence)
    each, threshold = log_bets(np.ones(1), 1.0, bar)[:, 0], -log(1.0 - confidence)
    low, high = 0, 1
    while log_mixture(high * each) < threshold:
        low, high = high, 2 * high
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if log_mixture(middle * each) < threshold else (low, middle)
    return high


def log_bets(values: NDArray[np.float64], shares: Any, mean: Any) -> NDArray[np.float64]:
    """Return the logarithm of what each bet turns a stake of 1 into with each value.

    The shape is (K, N), or (P, K, N) for P claims.

    Args:
        values: shape (N,), within [0, 1].
        shares: of the largest weight that a value has; one number, or shape (N,).
        mean: the claim that is bet against, between 0 and 1; or several, shape (P, 1, 1).
    """
    return same_bits.log(1.0 + _BETS[:, None] * (shares * (values / mean - 1.0)))


def log_mixture(powers: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the logarithm of the capital of all bets together from that of each, (..., K)."""
    each = _LOG_WEIGHTS + powers
    most = each.max(axis=-1)
    return most + same_bits.log(same_bits.exp(each - most[..., None]).sum(axis=-1))


def _weighted(
    groups: Groups,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.intp]]:
    """Return all different values, for each its weight divided by the largest, and their numbers.

    A value of a group of n among N in S groups weighs N / (S n), so that the weighted mean of all
    is the mean of the groups' means. Dividing by the largest keeps every bet solvent.
    """
    filled = [np.asarray(group, dtype=np.float64) for group in groups if len(group)]
    if not filled:
        return np.zeros(0), np.zeros(0), np.zeros(0, np.intp)
    values = np.concatenate(filled)
    if not ((values >= 0.0) & (values <= 1.0)).all():
        wrong = values[~((values >= 0.0) & (values <= 1.0))][0]
        raise ValueError(f"value {wrong} is not between 0 and 1")
    weights = np.concatenate([np.full(len(group), 1.0 / len(group)) for group in filled])
    # Trials have few different values: a logarithm of each is enough.
    distinct, counts = np.unique(values + 1j * (weights / weights.max()), return_counts=True)
    return np.real(distinct), np.imag(distinct), counts


def _log_capital(
    values: NDArray[np.float64],
    shares: NDArray[np.float64],
    counts: NDArray[np.intp],
    mean: Any,
) -> NDArray[np.float64]:
    return log_mixture((counts * log_bets(values, shares, mean)).sum(axis=-1))
