"""What trials show of a ladder: bounds of its limit that hold at any stopping time.

Rung j has the completion rate p_j, and is cleared where p_j >= q. Against "rung i is not cleared"
bets the wealth

    W_i = prod over trials at rungs j >= i of (1 + s_t (x_t - q)),   s_t >= 0,

where x_t is 1 for a completed trial and the stake s_t is fixed before it. Where rung i is not
cleared, no harder rung is, so that p_j < q at all these trials: W_i is a nonnegative
supermartingale and reaches 1 / alpha with probability at most alpha (Ville's inequality). Against
"rung i is cleared" bets

    V_i = prod over trials at rungs j <= i of (1 + s_t (q - x_t)),   s_t >= 0,

since then all easier rungs are cleared, too.

Rung i is claimed to be cleared once W_0 .. W_i have all reached 1 / alpha, at whatever times. A
claim beyond the limit L needs W_(L+1) among them, whose null hypothesis is true: the lower bound
errs with probability at most alpha, and no correction over rungs is needed (a fixed sequence of
tests: P. H. Westfall and A. Krishen, "Optimally weighted, fixed sequence and gatekeeper multiple
testing procedures", J. Stat. Plan. Inference 99 (2001)). The upper bound is the mirror image: from
the hardest rung, V_(n-1) .. V_i. Which rung is tried, and when the search stops, may depend on all
results so far.

Should the curve not be monotone, the lower bound still says that this rung or a harder one is
cleared, and the upper one that this rung or an easier one is not.

Source: I. Waudby-Smith and A. Ramdas, "Estimating means of bounded random variables by betting",
JRSS B 86 (2024), section 4, with two values of x alone; J. Ville, "Etude critique de la notion de
collectif" (1939).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import ceil, log

import numpy as np
from numpy.typing import NDArray

from nw_base import same_bits
from nw_gate.limits.curves import Array, Beliefs

Ints = NDArray[np.intp]
_MOST = 0.98  # A stake supposes no surer rate, so that no trial bankrupts it.
_ROUNDING = 1e-9


@dataclass(eq=False)
class Wealth:
    """Logarithms of what was won on B ladders of n rungs, all (B, n), and trials by rung."""

    cleared: Array
    """Of W_i, against "rung i is not cleared"."""
    failed: Array
    """Of V_i, against "rung i is cleared"."""
    most_cleared: Array
    """The largest value of `cleared` so far."""
    most_failed: Array
    """The largest value of `failed` so far."""
    done: Array
    """Completed trials."""
    missed: Array
    """Trials that were not completed."""

    @classmethod
    def at_start(cls, ladders: int, rungs: int) -> Wealth:
        """Return that of ladders without trials."""
        return cls(*(np.zeros((ladders, rungs)) for _ in fields(cls)))

    def some(self, keep: NDArray[np.bool_] | Ints | slice) -> Wealth:
        """Return a copy of those ladders alone."""
        return Wealth(*(getattr(self, field.name)[keep] for field in fields(self)))

    def bet(self, rung: Ints, done: NDArray[np.bool_], beliefs: Beliefs, share: float) -> None:
        """Take one trial of each ladder.

        The stake is that of the best bettor if the null is false: (r - q) / (q (1 - q)), with r the
        rate that is expected then. A completed trial multiplies W by r / q, another one by
        (1 - r) / (1 - q).

        Args:
            rung: (B,), where it was.
            done: (B,), whether it was completed.
            beliefs: what was expected before it.
            share: q.
        """
        every, i = np.arange(len(rung)), np.arange(self.done.shape[1])
        over = np.clip(beliefs.if_cleared[every, :, rung], share, max(_MOST, share))
        under = np.clip(beliefs.if_not[every, :, rung], min(1.0 - _MOST, share), share)
        for rate, side, logs, most in (
            (over, i <= rung[:, None], self.cleared, self.most_cleared),
            (under, i >= rung[:, None], self.failed, self.most_failed),
        ):
            gain = np.where(done[:, None], rate / share, (1.0 - rate) / (1.0 - share))
            np.add(logs, np.where(side, same_bits.log(gain), 0.0), out=logs)
            np.maximum(most, logs, out=most)
        self.done[every, rung] += done
        self.missed[every, rung] += ~done

    def count(self, rung: int, done: bool) -> None:
        """Take a trial of a single ladder for its curve alone, without a stake."""
        (self.done if done else self.missed)[0, rung] += 1.0

    def bounds(self, confidence: float) -> tuple[Ints, Ints]:
        """Return the hardest rung claimed cleared, -1 for none, and the easiest claimed not, or n.

        Args:
            confidence: of each bound, at least.
        """
        needed, rungs = -log(1.0 - confidence) - _ROUNDING, self.done.shape[1]
        cleared = np.logical_and.accumulate(self.most_cleared >= needed, axis=1)
        failed = np.logical_and.accumulate(self.most_failed[:, ::-1] >= needed, axis=1)
        return cleared.sum(axis=1) - 1, rungs - failed.sum(axis=1)


def fewest_trials(share: float, confidence: float) -> int:
    """Return how many completed trials a claim "cleared" needs, if no trial fails.

    Args:
        share: q.
        confidence: of the claim.
    """
    gain = log(max(_MOST, share) / share)
    return ceil(-log(1.0 - confidence) / gain) if gain > 0.0 else 1


def growth(rate: Array, share: float) -> Array:
    """Return what the logarithm of the best bettor's wealth gains by a trial, on average."""
    return rate * same_bits.log(rate / share) + (1.0 - rate) * same_bits.log(
        (1.0 - rate) / (1.0 - share)
    )
