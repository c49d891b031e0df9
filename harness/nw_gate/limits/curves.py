"""Which completion rates a ladder may have: a posterior over curves, for stakes and next rungs.

A curve falls along the ladder as a logistic function, from one minus a share of lapses down to 0.
The prior has a grid of positions, steepnesses and lapses. It may be wrong without harm: claims rest
on the wealth of `wealth.py`, which is valid for any curve. A prior that fits saves trials.

Sums are rounded to nine digits, so that the next rung is the same on every processor.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import log
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nw_base import same_bits

Array = NDArray[np.float64]

_STEP = 0.5  # rungs between positions
_SCALES = (0.08, 0.3, 0.6, 1.0, 1.6, 2.6)  # rungs; a cliff, and a fall over half a ladder
_CLIFFS = (0.5, 2.0)  # Below that scale a curve has this weight: obstacles are cliffs mostly.
_LAPSES = (0.0, 0.05, 0.12)  # where the share is 0.5; smaller in proportion above it
_LEAST = 0.01  # No rate is surer than this.
_SPREAD = 2.0  # rungs, of the normal prior around an expected limit
_TRUST = 0.75  # its share of the prior
_CURVE_WORTH = 50.0  # trials of a rung that weigh as much as the curve there
_CLAIM_WORTH = 100.0  # the same for the curves that a claim supposes


class Beliefs(NamedTuple):
    """Expected completion rates of B ladders with n rungs."""

    rate: Array
    """(B, n), of each rung."""
    if_cleared: Array
    """(B, n, n): [b, i, j] is that of rung j, should rung i be cleared."""
    if_not: Array
    """(B, n, n): [b, i, j] is that of rung j, should rung i not be cleared."""
    cleared: Array
    """(B, n + 1): probability that the limit is below rung 0, rung 0, rung 1 .. rung n - 1."""


@dataclass(frozen=True, eq=False)
class Curves:
    """C curves over n rungs, by rising limit."""

    rates: Array
    """(C, n)."""
    prior: Array
    """(C,): logarithms of weights."""
    ends: tuple[int, ...]
    """n + 2 indices: curves that clear k rungs are `ends[k]` to `ends[k + 1]`."""
    log_done: Array
    """(n, C): logarithms of the rates."""
    log_failed: Array
    """(n, C): logarithms of one minus the rates."""

    @classmethod
    @lru_cache(maxsize=64)
    def over(cls, rungs: int, share: float, expected: float | None = None) -> Curves:
        """Return the grid.

        Args:
            rungs: n.
            share: q; a rung is cleared where its rate is at least that.
            expected: index of the rung that is probably the limit; None = all are alike.
        """
        positions = np.arange(-1.5, rungs + 0.51, _STEP)
        lapses = np.array(_LAPSES) * 2.0 * (1.0 - share)
        grid = np.meshgrid(positions, np.array(_SCALES), lapses, indexing="ij")
        at, scale, lapse = (axis.ravel() for axis in grid)
        # A curve without lapses crosses `share` at its position.
        steps = (np.arange(rungs) - at[:, None]) / scale[:, None]
        steps = np.clip(steps + log((1.0 - share) / share), -40.0, 40.0)
        rates = (1.0 - lapse[:, None]) / (1.0 + same_bits.exp(steps))
        rates = np.clip(rates, _LEAST, 1.0 - _LEAST)
        limits = (rates >= share).sum(axis=1)
        weights = np.where(scale < _CLIFFS[0], _CLIFFS[1], 1.0)
        # Each limit has the same prior probability.
        weights /= np.bincount(limits, weights, rungs + 1)[limits]
        weights /= weights.sum()
        if expected is not None:
            near = weights * same_bits.exp(-0.5 * ((at - 0.5 - expected) / _SPREAD) ** 2)
            weights = (1.0 - _TRUST) * weights + _TRUST * near / near.sum()
        order = np.argsort(limits, kind="stable")
        rates, weights = rates[order], weights[order]
        ends = np.searchsorted(limits[order], np.arange(rungs + 2))
        return cls(
            rates,
            same_bits.log(weights),
            tuple(int(end) for end in ends),
            np.ascontiguousarray(same_bits.log(rates).T),
            np.ascontiguousarray(same_bits.log(1.0 - rates).T),
        )

    def weights(self, done: Array, failed: Array) -> Array:
        """Return the posterior, (B, C), after trials by rung, both (B, n)."""
        logs = self.prior + done @ self.log_done + failed @ self.log_failed
        weights = same_bits.exp(logs - logs.max(axis=1, keepdims=True))
        return weights / weights.sum(axis=1, keepdims=True)

    def beliefs(self, done: Array, failed: Array) -> Beliefs:
        """Return expected rates after trials by rung, both (B, n).

        A rung's own trials correct its curve: they weigh as much as they are many.
        """
        weights = self.weights(done, failed)
        ladders, rungs = done.shape
        mass = np.empty((ladders, rungs + 1))
        mean = np.empty((ladders, rungs + 1, rungs))
        for k in range(rungs + 1):
            some = slice(self.ends[k], self.ends[k + 1])
            mass[:, k] = weights[:, some].sum(axis=1)
            mean[:, k] = weights[:, some] @ self.rates[some]
        mass, mean = np.round(mass, 9), np.round(mean, 9)
        # A claim that the curves rule out is still given a rate on its side.
        under = _ratio(mean.cumsum(1)[:, :-1], mass.cumsum(1)[:, :-1], 0.25)
        mean_down, mass_down = mean[:, ::-1].cumsum(1), mass[:, ::-1].cumsum(1)
        over = _ratio(mean_down[:, -2::-1], mass_down[:, -2::-1], 0.75)
        tried = done + failed
        return Beliefs(
            (_CURVE_WORTH * mean.sum(axis=1) + done) / (_CURVE_WORTH + tried),
            (_CLAIM_WORTH * over + done[:, None]) / (_CLAIM_WORTH + tried[:, None]),
            (_CLAIM_WORTH * under + done[:, None]) / (_CLAIM_WORTH + tried[:, None]),
            mass,
        )

    def band(self, done: Array, failed: Array, inside: float) -> tuple[Array, Array, Array]:
        """Return mean, low and high end of each rung's rate, each (n,), of one ladder.

        The ends are widened to the mean, which may lie outside where one of few curves is far off.

        Args:
            done: (n,), trials completed.
            failed: (n,), trials that were not.
            inside: posterior probability between the two ends.
        """
        weights = np.round(self.weights(done[None], failed[None])[0], 9)
        low, high = (np.empty(len(done)) for _ in range(2))
        for j, rates in enumerate(self.rates.T):
            order = np.argsort(rates, kind="stable")
            share = weights[order].cumsum()
            cuts = share[-1] * np.array([0.5 - inside / 2.0, 0.5 + inside / 2.0])
            low[j], high[j] = rates[order][np.searchsorted(share, cuts)]
        mean = np.round((weights[:, None] * self.rates).sum(axis=0) / weights.sum(), 9)
        return mean, np.minimum(low, mean), np.maximum(high, mean)


def _ratio(mean: Array, mass: Array, otherwise: float) -> Array:
    """Return the ratio, and `otherwise` where both are next to nothing."""
    return (mean + 1e-9 * otherwise) / (mass[:, :, None] + 1e-9)
