"""Evidence against a drop: a baseline, null hypotheses, and a test martingale for each.

**The baseline** is what the baseline scores from every start, known because simulation repeats its
bits. There are S scenes with M starts each. b_si is the baseline's success from start i of scene s,
B_s its mean over the starts of scene s, and B the mean of all B_s; c_si is the candidate's success.

The candidate is judged by c less what is known of the starts' difficulty:

    z_si = c_si - g_si + B,     g_si = B_s + beta (b_si - B_s),     0 <= beta <= 1.

Over the seed set the mean of g is B, so that z has the candidate's mean whatever beta is. Within a
scene z varies less than c as far as the two policies find the same starts hard.

**The capital** is that of a bettor who bets that a mean is higher than a null allows, drawing for
good. A box has M numbers y >= 0. They are drawn one by one in random order and not put back. The
null says that their mean is at most n. Then those that are left before draw r have at most the mean

    n_r = (M n - sum over earlier draws q of y_q) / (M - r + 1),

and a bettor who bets the share k of the capital at odds that are fair at n_r has

    E = sum_k w_k  prod_r (1 + k (y_r - n_r) / n_r),     sum_k w_k = 1,  0 < k < 1.

Given the past, draw r is any of the numbers left with the same probability, so that its expectation
is their mean mu_r <= n_r. That of its factor is 1 + k (mu_r / n_r - 1) <= 1, and no factor is below
1 - k > 0. So E is a supermartingale under the null that begins at 1 and is never negative. By
Ville's inequality it reaches 1 / alpha, after any of the draws, with probability at most alpha.

What is left cannot have a mean below 0: where n_r is, the null is impossible and E infinite.

With M infinite nothing is ever used up, n_r = n, and no null of n >= 0 is impossible: y may be any
numbers of which each has at most the expectation n, given the past. That is what a claim about
fresh starts needs: the starts that were drawn are then a sample, and say nothing certain of those
that were not. `trials` says what becomes of it on a seed set that is finite after all.

**Three nulls** are bet against, each by `along` on numbers y >= 0. With z as above, and z_min and
z_max the least and the most that it can be:

    PASS       "the drop is at least max_drop"       y = z - z_min   n = B - max_drop - z_min
    REGRESSED  "the drop is at most tolerate"        y = z_max - z   n = z_max - (B - tolerate)
    scene s    "its drop is at most scene_drop"      y = 1 - c       n = 1 - (B_s - scene_drop)

(beside a concurrent control, where b is no part of a baseline: y = 1 - c + b, n = 1 + scene_drop),
so that a factor is 1 + k (z - m_r) / (m_r - z_min), or 1 + k (m_r - z) / (z_max - m_r), where m_r
is the mean of z that the null leaves for the rest. The first two are means over beta in {0, 1/2}
and bet on the trials of all scenes; a scene's bets are on its own trials. A mean of such processes
is one. Where the baseline's results are known, most of the capital for the first two is on bets
made from these instead: `baseline_bets`.

Source: I. Waudby-Smith and A. Ramdas, "Confidence sequences for sampling without replacement",
NeurIPS 33 (2020), arXiv 2006.04347; J. Ville, "Etude critique de la notion de collectif" (1939).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf

import numpy as np
from numpy.typing import NDArray

from nw_gate.stats.baseline.baseline_bets import BaselineBets

Floats = NDArray[np.float64]
Places = NDArray[np.intp]
Truths = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class Reference:
    """What a candidate is compared with: a baseline's means, or a concurrent control.

    Raises:
        ValueError: a mean is not between 0 and 1, there is no scene, or not one start.
    """

    means: Floats
    """B_s, shape (S,); leading axes, if any, are of gates apart."""
    starts: float = inf
    """M; infinite for a claim about fresh starts, so that no draw leaves less for the rest."""
    paired: bool = False
    """Whether b is what the baseline's policy scored beside the candidate, from the same start and
    on the same machine (a concurrent control). Then c - b alone counts, and no mean of a baseline:
    z = c - b + B, which is 1 + c - b above its least, whatever B is."""
    bets: BaselineBets | None = None
    """Made from the baseline's results; without them all capital is on fixed bets."""

    def __post_init__(self) -> None:
        if self.means.ndim < 1 or not self.means.shape[-1]:
            raise ValueError("a baseline needs the mean of one scene at least")
        check_successes(self.means)
        if not self.starts >= 1:
            raise ValueError(
                f"{self.starts} initial states in each scene; a baseline needs at least one"
            )

    @classmethod
    def of(cls, scores: Floats) -> Reference:
        """Return the known baseline of successes b_si on the whole seed set, shape (S, M)."""
        check_successes(scores)
        return cls(means=scores.mean(axis=-1), starts=scores.shape[-1])

    @classmethod
    def control(cls, scenes: int) -> Reference:
        """Return the stand-in for the baseline of a concurrent control of S scenes: no mean."""
        return cls(means=np.ones(scenes), paired=True)

    def fresh(self) -> Reference:
        """Return the baseline for a claim about fresh starts: M is infinite."""
        return replace(self, starts=inf)

    def only(self, which: Places) -> Reference:
        """Return the baselines of some gates, by position along the first axis of the means."""
        bets = None if self.bets is None else self.bets.only(which)
        return replace(self, means=self.means[which], bets=bets)

    @property
    def betas(self) -> tuple[float, ...]:
        """How much of a start's own difficulty is used, once for each bettor."""
        return (1.0,) if self.paired else (0.0, 0.5)

    @property
    def mean(self) -> Floats:
        """B, scenes weighted equally."""
        return self.means.mean(axis=-1, keepdims=True)

    def least(self, beta: float) -> Floats:
        """Return z_min = B - max_s ((1 - beta) B_s + beta), the least that z can be."""
        return self.mean - ((1.0 - beta) * self.means + beta).max(axis=-1, keepdims=True)

    def most(self, beta: float) -> Floats:
        """Return z_max = B + 1 - min_s ((1 - beta) B_s), the most that z can be."""
        return self.mean + 1.0 - ((1.0 - beta) * self.means).min(axis=-1, keepdims=True)


def check_successes(values: Floats) -> None:
    """Raise ValueError for a success that is not between 0 and 1, NaN among them."""
    inside = (values >= 0.0) & (values <= 1.0)
    if not inside.all():
        raise ValueError(f"success {values[~inside][0]} is not between 0 and 1")


_TOLERANCE = 1e-9
"""How far below 0 the rest's mean must be. Sums of a null that is just true are off by 1e-14."""

_SMALLEST = 1e-6
"""The least mean that odds are figured from: where nothing but zeros may be left, a y of 1e-16 by
rounding must not win. Smaller bets than fair odds allow are valid bets."""

_MOST = 1e150
"""Where capital is capped, so that the product of two is finite; a cap only loses evidence."""


@dataclass(frozen=True, kw_only=True)
class Bets:
    """Shares of the capital that are bet, each on an account of its own."""

    shares: tuple[float, ...]
    """k, shape (K,), each above 0 and at most 1; of 1 a y of 0 takes all."""
    weights: tuple[float, ...]
    """w: of each account at the start, shape (K,); they sum to 1."""


def along(values: Floats, null: Floats, size: float, bets: Bets) -> Floats:
    """Return E after each of T draws, shape (..., T); leading axes are boxes apart.

    Capital is a product and not a sum of logarithms: products are the same bits on every machine.

    Args:
        values: y in the order drawn, shape (..., T).
        null: n, shape (...).
        size: M, how many numbers a box has, T at least; may be infinite.
        bets: shares of the capital.

    Raises:
        ValueError: there are more draws than numbers.
    """
    count = values.shape[-1]
    if count > size:
        raise ValueError(f"{count} draws of {size} numbers")
    rest = after = np.broadcast_to(null[..., None], values.shape)
    if size < inf:
        drawn = np.arange(count)
        sums = np.cumsum(values, axis=-1)
        before = np.concatenate([np.zeros_like(sums[..., :1]), sums[..., :-1]], axis=-1)
        rest = null[..., None] + (drawn * null[..., None] - before) / (size - drawn)
        owed, left = (drawn + 1) * null[..., None] - sums, size - drawn - 1
        after = np.where(left, null[..., None] + owed / np.maximum(left, 1), owed)
    won = (values - np.maximum(rest, 0.0)) / np.maximum(rest, _SMALLEST)
    mixed = np.zeros(values.shape)
    with np.errstate(over="ignore"):
        for share, weight in zip(bets.shares, bets.weights, strict=True):
            mixed += weight * np.minimum(np.cumprod(1.0 + share * won, axis=-1), _MOST)
    return np.where(after < -_TOLERANCE, inf, mixed)


UP = Bets(shares=(0.4, 0.6, 0.8, 0.95), weights=(0.2, 0.2, 0.4, 0.2))
"""Bets for PASS."""

WHOLE = Bets(shares=(1.0,), weights=(1.0,))
"""Bets of an account of `baseline_bets`, whose numbers are factors of the capital already."""

DOWN = Bets(shares=(0.05, 0.1, 0.2, 0.4, 0.8), weights=(0.2, 0.2, 0.2, 0.2, 0.2))
"""Bets for REGRESSED and against single scenes."""


@dataclass(frozen=True, kw_only=True)
class Margins:
    """Drops of mean success, the baseline's less the candidate's.

    Raises:
        ValueError: not 0 <= tolerate <= max_drop < 1, or not 0 <= scene_drop < 1.
    """

    max_drop: float = 0.10
    """A drop as large as this must not pass."""
    tolerate: float = 0.02
    """A drop as small as this must not be flagged; between the two either may happen."""
    scene_drop: float = 0.10
    """A drop in one scene as small as this must not be held against that scene."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.tolerate <= self.max_drop < 1.0:
            raise ValueError(f"drops {self.tolerate} to {self.max_drop} are not within 0 to 1")
        if not 0.0 <= self.scene_drop < 1.0:
            raise ValueError(f"drop {self.scene_drop} of a scene is not within 0 to 1")


def nulls_at_least(reference: Reference, drop: Floats | float) -> list[Floats]:
    """Return n of "the drop is at least this" for each beta, and for each account of the bets.

    Args:
        reference: the baseline to compare with.
        drop: shape (); or, of one baseline without leading axes, any shape: so many nulls apart.
    """
    mean = reference.mean[..., 0] - drop
    own = [mean - reference.least(beta)[..., 0] for beta in reference.betas]
    return (
        own
        if reference.bets is None
        else [*own, *(reference.bets.null(x, mean) for x in reference.bets.above)]
    )


def nulls_at_most(reference: Reference, drop: Floats | float) -> list[Floats]:
    """Return n of "the drop is at most this" as `nulls_at_least` does."""
    mean = reference.mean[..., 0] - drop
    own = [reference.most(beta)[..., 0] - mean for beta in reference.betas]
    if reference.bets is None:
        return own
    return [*own, *(reference.bets.null(each, 1.0 - mean) for each in reference.bets.below)]


def capital(
    reference: Reference, values: Sequence[Floats], nulls: Sequence[Floats], bets: Bets
) -> Floats:
    """Return E against one null on the mean after each trial, shape (..., T).

    Args:
        reference: the baseline to compare with.
        values: y of the trials for each beta and each account, shape (..., T).
        nulls: n of each; of one baseline any shape, which E has then, with an axis T.
        bets: what is bet on those of each beta: `UP` or `DOWN`.
    """
    own = len(reference.betas)
    accounts = (
        ()
        if reference.bets is None
        else reference.bets.above
        if bets is UP
        else reference.bets.below
    )
    left = 1.0 - sum(account.weight for account in accounts)
    weights = [*[left / own] * own, *(account.weight for account in accounts)]
    pairs = reference.starts * reference.means.shape[-1]
    total = np.zeros(())
    for index, (weight, y, null) in enumerate(zip(weights, values, nulls, strict=True)):
        shape = np.broadcast_shapes(y.shape, (*null.shape, 1))
        each = along(np.broadcast_to(y, shape), null, pairs, bets if index < own else WHOLE)
        total = total + weight * each
    return total


def scene_nulls(reference: Reference, margins: Margins) -> Floats:
    """Return n of each scene alone, shape (S,): 1 less the least mean of c that its null allows."""
    return (
        1.0
        - ((0.0 if reference.paired else reference.means) - margins.scene_drop)
        + np.zeros_like(reference.means)
    )


def scene_losses(reference: Reference, candidate: Floats, baseline: Floats) -> Floats:
    """Return y = 1 - c, or 1 - (c - b) beside a control: what a scene's evidence is won by."""
    return 1.0 - (candidate - baseline if reference.paired else candidate)
