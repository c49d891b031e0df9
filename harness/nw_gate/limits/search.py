"""Which rung to try next: the one that brings the cheapest sufficient pair of claims nearer.

A search ends once a claim "rung a is cleared" and a claim "rung b is not", `width` rungs apart or
less, are made. What a claim still costs is the missing logarithm of its wealth divided by the gain
of a trial there. The search aims at the pair that costs least, not at the one next to the limit: a
rung whose rate is near the share would take all trials. Of the pair it tries the rung whose rate is
nearer to the share, since its result changes the aim most.

Where no pair of that width can be had for the trials that are left, it aims at the narrowest wider
pair that can. So a search that stays undecided has bounds that are as near as its trials allow.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log

import numpy as np

from nw_gate.limits.curves import Array, Beliefs, Curves
from nw_gate.limits.wealth import Ints, Wealth, growth

_HOPE = 0.4  # How far a cost supposes that its claim is true.
_CERTAIN = 0.98
_LEAST_GAIN = 1e-4
_LEAST_MISSING = 0.2
_CENTRE = 0.3  # trials that a pair costs more for each rung from the middle of the posterior
_HOPELESS = 2.0  # Costs are estimates: a pair is given up if it costs so many times what is left.
_NEVER = 1e12


@dataclass(frozen=True, kw_only=True, eq=False)
class Search:
    """How ladders are searched, B at a time."""

    curves: Curves
    share: float
    confidence: float
    width: int
    most: int
    """Trials of a ladder, at most."""

    def beliefs(self, wealth: Wealth) -> Beliefs:
        """Return what is expected after the trials so far."""
        return self.curves.beliefs(wealth.done, wealth.missed)

    def ended(self, wealth: Wealth) -> np.ndarray:
        """Return for each ladder whether its bounds are at most `width` rungs apart."""
        low, high = wealth.bounds(self.confidence)
        return high - low <= self.width

    def next(self, wealth: Wealth, beliefs: Beliefs) -> Ints:
        """Return the rung to try next, of each ladder."""
        ladders, rungs = wealth.done.shape
        bounds = wealth.bounds(self.confidence)
        low, high = (bound[:, None] for bound in bounds)
        i, every = np.arange(rungs), np.arange(ladders)
        gain_cleared, gain_failed = gains(beliefs, self.share)
        needed = -log(1.0 - self.confidence)
        # A claim needs the wealth of all nulls before it.
        have = np.minimum.accumulate(np.where(i <= low, np.inf, wealth.cleared), axis=1)
        cost_low = np.where(i <= low, 0.0, np.maximum(needed - have, _LEAST_MISSING) / gain_cleared)
        have = np.minimum.accumulate(np.where(i >= high, np.inf, wealth.failed)[:, ::-1], axis=1)
        cost_high = np.where(
            i >= high, 0.0, np.maximum(needed - have[:, ::-1], _LEAST_MISSING) / gain_failed
        )
        zero = np.zeros((ladders, 1))
        costs = np.hstack([zero, cost_low]), np.hstack([cost_high, zero])
        middle = (np.cumsum(beliefs.cleared, axis=1) < 0.5).sum(axis=1)[:, None] - 0.5
        a, b, cost = _cheapest_pair(costs, low, middle, self.width)
        left = self.most - (wealth.done + wealth.missed).sum(axis=1)
        # What is claimed already is no aim: pairs are narrower than the bounds so far.
        for wider in range(self.width + 1, rungs + 1):
            rows = np.flatnonzero((cost > _HOPELESS * left) & (wider < bounds[1] - bounds[0]))
            if not len(rows):
                break
            those = costs[0][rows], costs[1][rows]
            a[rows], b[rows], cost[rows] = _cheapest_pair(those, low[rows], middle[rows], wider)
        easy, hard = np.clip(a, 0, rungs - 1), np.clip(b, 0, rungs - 1)
        near = np.abs(beliefs.rate[every, easy] - self.share) <= np.abs(
            beliefs.rate[every, hard] - self.share
        )
        free_low, free_high = a <= low[:, 0], b >= high[:, 0]
        return np.where(free_low | (~free_high & ~near), hard, easy)


def _cheapest_pair(
    costs: tuple[Array, Array], low: Ints, middle: Array, width: int
) -> tuple[Ints, Ints, Array]:
    """Return the pair of claims `width` rungs apart that costs least, and its cost, all (B,).

    Args:
        costs: of each claim "cleared", and of each "not cleared"; what lies off the ladder costs
            nothing. Both (B, n + 1): from rung -1, and up to rung n.
        low: the hardest rung that is claimed to be cleared, (B, 1).
        middle: of the posterior, (B, 1).
        width: in rungs.
    """
    count = costs[0].shape[1]
    a = np.arange(-1, count - 1)
    b = np.minimum(a + width, count - 1)
    both = costs[0] + costs[1][:, np.maximum(b, 0)]
    both = both + _CENTRE * np.abs(a + width / 2.0 - middle)
    both = np.where((a >= low) & (b >= 0), np.round(both, 6), _NEVER)
    pair = np.argmin(both, axis=1)
    return a[pair], b[pair], both[np.arange(len(both)), pair]


def gains(beliefs: Beliefs, share: float) -> tuple[Array, Array]:
    """Return what a trial gains for "cleared" and for "not cleared" at each rung, both (B, n)."""
    gains: list[Array] = []
    for given, sign in ((beliefs.if_cleared, 1.0), (beliefs.if_not, -1.0)):
        own = np.diagonal(given, axis1=1, axis2=2)
        rate = np.clip((1.0 - _HOPE) * beliefs.rate + _HOPE * own, 1.0 - _CERTAIN, _CERTAIN)
        usable = sign * (rate - share) > 0.0
        gains.append(np.where(usable, np.maximum(growth(rate, share), _LEAST_GAIN), _LEAST_GAIN))
    return gains[0], gains[1]
