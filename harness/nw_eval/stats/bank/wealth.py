"""The wealth of a gambler who bets that a mean is higher than a null allows, drawing for good.

A box has M numbers y >= 0. They are drawn one by one in random order and not put back. The null
says that their mean is at most n. Then those that are left before draw r have at most the mean

    n_r = (M n - sum over earlier draws q of y_q) / (M - r + 1),

and a gambler who bets the share k of the wealth at odds that are fair at n_r has

    E = sum_k w_k  prod_r (1 + k (y_r - n_r) / n_r),     sum_k w_k = 1,  0 < k < 1.

Given the past, draw r is any of the numbers left with the same probability, so that its expectation
is their mean mu_r <= n_r. That of its factor is 1 + k (mu_r / n_r - 1) <= 1, and no factor is below
1 - k > 0. So E is a supermartingale under the null that begins at 1 and is never negative. By
Ville's inequality it reaches 1 / alpha, after any of the draws, with probability at most alpha.

What is left cannot have a mean below 0: where n_r is, the null is impossible and E infinite.

With M infinite nothing is ever used up, n_r = n, and no null of n >= 0 is impossible: y may be any
numbers of which each has at most the expectation n, given the past. That is what a claim about
fresh starts needs: the starts that were drawn are then a sample, and say nothing certain of those
that were not. `trials` says what becomes of it on a panel that is finite after all.

Source: I. Waudby-Smith and A. Ramdas, "Confidence sequences for sampling without replacement",
NeurIPS 33 (2020), arXiv 2006.04347; J. Ville, "Etude critique de la notion de collectif" (1939).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import numpy as np

from nw_eval.stats.bank.panel import Floats

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


def along(values: Floats, null: Floats, size: float, bets: Bets) -> Floats:
    """Return E after each of T draws, shape (..., T); leading axes are boxes apart.

    Wealth is a product and not a sum of logarithms: products are the same bits on every machine.

    Args:
        values: y in the order drawn, shape (..., T).
        null: n, shape (...).
        size: M, how many numbers a box has, T at least; may be infinite.
        bets: shares of the wealth.

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
