"""The wealth of a gambler who bets that a mean is higher than a null allows, drawing for good.

Each of M rounds draws N numbers y >= 0, one from each of N boxes of M numbers, without putting them
back. The null says that all the boxes' numbers have a mean of at most n. Then those that are left
before round r have at most the mean

    n_r = (M n - sum over earlier rounds q of mean_i y_iq) / (M - r + 1),

and a gambler who bets the share k of the wealth at odds that are fair at n_r has

    E = sum_k w_k  prod_r prod_i (1 + k (y_ir - n_r) / n_r),     sum_k w_k = 1,  0 < k < 1.

Given the past, the draws of a round are independent between boxes, each with the mean mu_i of what
its box has left. The expectation of the round's product is prod_i (1 + k (mu_i / n_r - 1)), which
by the inequality of arithmetic and geometric means is at most (1 + k (mu / n_r - 1))^N <= 1, where
mu <= n_r is the mean of the mu_i. So E is a supermartingale under the null, and by Ville's
inequality reaches 1 / alpha, at any of the rounds, with probability at most alpha.

What is left cannot have a mean below 0: where n_r is, the null is impossible and E infinite.

With M infinite nothing is ever used up, n_r = n, and no null is impossible. That is what a claim
about fresh starts needs: the starts that were drawn are then a sample, and say nothing certain of
those that were not. On a panel that is finite after all it is at least as cautious (`trials`).

Where N is 1 the draws are those of one box, one number at a time: `along` has E after each of them.

Source: I. Waudby-Smith and A. Ramdas, "Confidence sequences for sampling without replacement",
NeurIPS 33 (2020), arXiv 2006.04347; J. Ville, "Etude critique de la notion de collectif" (1939).
Boxes of unequal means are by the inequality above, as in `stats.betting`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf

import numpy as np

from nw_eval.stats.bank.panel import Floats, Places

_TOLERANCE = 1e-9
"""How far below 0 the rest's mean must be. Sums of a null that is just true are off by 1e-14."""

_SMALLEST = 1e-6
"""The least mean that odds are figured from: where nothing but zeros may be left, a y of 1e-16 by
rounding must not win. Smaller bets than fair odds allow are valid bets."""

_MOST = 1e150
"""Where wealth is capped, so that the product of two is finite; a cap only loses evidence."""


@dataclass(frozen=True, kw_only=True)
class Bets:
    """Shares of the wealth that are bet, each on an account of its own."""

    shares: tuple[float, ...]
    """k, shape (K,), each above 0 and below 1."""
    weights: tuple[float, ...]
    """w: of each account at the start, shape (K,); they sum to 1."""


@dataclass(frozen=True, kw_only=True)
class Wealth:
    """A gambler after some rounds. Leading axes are gamblers who know nothing of each other.

    Wealth is a product and not a sum of logarithms: products are the same bits on every machine.
    """

    null: Floats
    """n, shape (...)."""
    starts: float
    """M; may be infinite."""
    bets: Bets
    accounts: Floats
    """What each bet has made of a stake of 1, shape (..., K)."""
    total: Floats
    """Sum over rounds of the mean of y, shape (...)."""
    rounds: int = 0

    @classmethod
    def before(cls, null: Floats, starts: float, bets: Bets) -> Wealth:
        """Return the gambler before the first round."""
        stakes = np.ones((*null.shape, len(bets.shares)))
        return cls(null=null, starts=starts, bets=bets, accounts=stakes, total=np.zeros(null.shape))

    def after(self, values: Floats) -> Wealth:
        """Return the gambler after one more round.

        Args:
            values: y, shape (..., N).

        Raises:
            ValueError: there have been M rounds.
        """
        if self.rounds >= self.starts:
            raise ValueError(f"round {self.rounds + 1} of a bank with {self.starts} starts a scene")
        rest = self._rest()[..., None]
        won = (values - np.maximum(rest, 0.0)) / np.maximum(rest, _SMALLEST)
        factors = 1.0 + np.array(self.bets.shares)[:, None] * won[..., None, :]
        with np.errstate(over="ignore"):
            gains = np.minimum(factors.prod(axis=-1), _MOST)
        return replace(
            self,
            accounts=np.minimum(self.accounts * gains, _MOST),
            total=self.total + values.mean(axis=-1),
            rounds=self.rounds + 1,
        )

    def only(self, which: Places) -> Wealth:
        """Return some of the gamblers, by their places along the first axis."""
        return replace(
            self,
            null=self.null[which],
            accounts=self.accounts[which],
            total=self.total[which],
        )

    @property
    def evidence(self) -> Floats:
        """E, shape (...): infinite where the null has become impossible."""
        mixed = (self.accounts * np.array(self.bets.weights)).sum(axis=-1)
        return np.where(self._rest() < -_TOLERANCE, inf, mixed)

    def _rest(self) -> Floats:
        """Return n_r of the next round; after the last one, the sum that the null still owes."""
        left = self.starts - self.rounds
        owed = self.rounds * self.null - self.total
        return self.null + owed / left if left else owed


def along(values: Floats, null: Floats, starts: float, bets: Bets) -> Floats:
    """Return E after each of T draws of one number, shape (..., T).

    It is what `Wealth.after` makes of them one by one, for all T at once.

    Args:
        values: y in the order drawn, shape (..., T).
        null: n, shape (...).
        starts: M, how many numbers the box has; T at most.
        bets: shares of the wealth.

    Raises:
        ValueError: there are more draws than numbers.
    """
    count = values.shape[-1]
    if count > starts:
        raise ValueError(f"{count} draws of {starts} numbers")
    rest = after = np.broadcast_to(null[..., None], values.shape)
    if starts < inf:
        drawn = np.arange(count)
        sums = np.cumsum(values, axis=-1)
        before = np.concatenate([np.zeros_like(sums[..., :1]), sums[..., :-1]], axis=-1)
        rest = null[..., None] + (drawn * null[..., None] - before) / (starts - drawn)
        owed, left = (drawn + 1) * null[..., None] - sums, starts - drawn - 1
        after = np.where(left, null[..., None] + owed / np.maximum(left, 1), owed)
    won = (values - np.maximum(rest, 0.0)) / np.maximum(rest, _SMALLEST)
    mixed = np.zeros(values.shape)
    with np.errstate(over="ignore"):
        for share, weight in zip(bets.shares, bets.weights, strict=True):
            mixed += weight * np.minimum(np.cumprod(1.0 + share * won, axis=-1), _MOST)
    return np.where(after < -_TOLERANCE, inf, mixed)
