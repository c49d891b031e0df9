"""Whether an easier rung is completed less often than a harder one.

Against "no rung has a lower completion rate than a harder one" stands

    E = M / max over falling p of L(p),

of the likelihood L of all trials. M is a mixture of likelihoods that is fixed beforehand: falling
curves of which one rung is off, with a part of its completions or of its failures, and rungs with
rates of their own, each by Krichevsky and Trofimov's mixture (IEEE Trans. Inf. Theory 27 (1981)).
The denominator is by pooling adjacent violators (M. Ayer et al., Ann. Math. Stat. 26 (1955)). The
expectation of E is at most 1 for every falling curve, at any stopping time and for any choice of
rungs: E >= 1 / alpha has probability at most alpha.

Source: L. Wasserman, A. Ramdas and S. Balakrishnan, "Universal inference", PNAS 117 (2020),
section 7.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import log

import numpy as np

from nw_base import same_bits
from nw_gate.limits.curves import Array, Curves

_KEPT = np.array([0.1, 0.4])  # Parts of completions, or of failures, that a rung keeps.
_DIPS, _BUMPS, _FREE = 0.6, 0.2, 0.2  # weights of the mixture


@dataclass(frozen=True, kw_only=True)
class Dip:
    """Two rungs of which the easier one is completed less often.

    Attributes:
        easier: its index.
        harder: index of the other one.
    """

    easier: int
    harder: int


def find_dip(done: Array, missed: Array, confidence: float = 0.95) -> Dip | None:
    """Return where a curve is not monotone; None if that is not shown.

    Args:
        done: (n,), completed trials by rung, from the easiest.
        missed: (n,), the other trials.
        confidence: probability, at least, that None is returned for a falling curve.
    """
    if log_evidence(done, missed) < -log(1.0 - confidence):
        return None
    rungs = np.flatnonzero(done + missed > 0)
    pairs = [(int(i), int(j)) for k, i in enumerate(rungs) for j in rungs[k + 1 :]]
    i, j = max(pairs, key=lambda pair: _contrast(done, missed, *pair))
    return Dip(easier=i, harder=j)


def log_evidence(done: Array, missed: Array) -> float:
    """Return the logarithm of E, of trials by rung."""
    free = sum(_log_predicted(int(d), int(m)) for d, m in zip(done, missed, strict=True))
    curves = Curves.over(len(done), 0.5)
    base = curves.prior + done @ curves.log_done + missed @ curves.log_failed
    tried = np.flatnonzero(done + missed)
    own = (
        done[tried, None] * curves.log_done[tried] + missed[tried, None] * curves.log_failed[tried]
    )
    logs = [np.array([free + log(_FREE)])]
    for weight, d, m, (log_off, log_rest) in zip(
        (_DIPS, _BUMPS), (done, missed), (missed, done), _one_off(len(done)), strict=True
    ):
        moved = d[tried, None] * log_off[:, tried] + m[tried, None] * log_rest[:, tried]
        logs.append((base + moved - own).ravel() + log(weight / (len(_KEPT) * len(done))))
        if len(tried) < len(done):  # A rung without trials may be off or not.
            logs.append(base + log(weight * (len(done) - len(tried)) / len(done)))
    every = np.concatenate(logs)
    mixture = float(every.max() + log(same_bits.exp(every - every.max()).sum()))
    blocks: list[tuple[float, float]] = []
    for d, m in zip(done.tolist(), missed.tolist(), strict=True):
        if d + m == 0:
            continue
        blocks.append((d, m))
        # A block that is completed more often than the one before is pooled with it.
        while len(blocks) > 1 and _rate(blocks[-1]) > _rate(blocks[-2]):
            (a, b), (c, e) = blocks.pop(), blocks.pop()
            blocks.append((a + c, b + e))
    return mixture - sum(_log_likelihood(*block) for block in blocks)


@lru_cache(maxsize=64)
def _one_off(rungs: int) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Return logarithms of chances (2, n, C) where a rung keeps a part of its completions.

    The first two are of a completion and of a failure; the other two of a failure and of a
    completion, where it keeps a part of its failures.
    """
    rates = Curves.over(rungs, 0.5).rates.T
    dips, bumps = (_KEPT[:, None, None] * each for each in (rates, 1.0 - rates))
    return (same_bits.log(dips), same_bits.log(1.0 - dips)), (
        same_bits.log(bumps),
        same_bits.log(1.0 - bumps),
    )


def _rate(block: tuple[float, float]) -> float:
    return block[0] / (block[0] + block[1])


def _log_predicted(done: int, missed: int) -> float:
    """Return the logarithm of B(d + 1/2, m + 1/2) / B(1/2, 1/2)."""
    halves = same_bits.log(np.r_[np.arange(done), np.arange(missed)] + 0.5).sum()
    return float(halves - same_bits.log(np.arange(1.0, done + missed + 1)).sum())


def _log_likelihood(done: float, missed: float) -> float:
    """Return the largest logarithm of p^d (1 - p)^m."""
    counts = np.array([count for count in (done, missed) if count > 0.0])
    return float((counts * same_bits.log(counts / (done + missed))).sum())


def _contrast(done: Array, missed: Array, i: int, j: int) -> float:
    """Return how much better two rates explain rungs i and j than one, where j's is higher."""
    one, other = (float(done[i]), float(missed[i])), (float(done[j]), float(missed[j]))
    pooled = _log_likelihood(one[0] + other[0], one[1] + other[1])
    gain = _log_likelihood(*one) + _log_likelihood(*other) - pooled
    return gain if _rate(other) > _rate(one) else -gain
