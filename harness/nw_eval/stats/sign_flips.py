"""Whether paired differences lean to one side: the test that flips their signs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_EXACT = 14
"""Differences of which all combinations of signs are looked at."""
_DRAWS = 20_000
_ROUNDING = 1e-9


def leans_above(differences: NDArray[np.float64]) -> float:
    """Return the p value of paired differences having a sum this large by chance alone.

    Under the hypothesis both sides of a pair could be exchanged, so each difference could as well
    have the other sign. The p value is the share of combinations of signs whose sum is at least the
    one that was seen: of all of them, or of 20,000 drawn ones and the one that was seen (Fisher
    1935, The Design of Experiments, section 21; Phipson & Smyth 2010 for what is drawn).

    Args:
        differences: (N,) of pairs, in any order; zeros say nothing.
    """
    sizes = np.sort(np.abs(differences[differences != 0.0]))
    seen = float(np.sum(differences))
    if not len(sizes):
        return 1.0
    if len(sizes) <= _EXACT:
        combinations = np.arange(2 ** len(sizes))[:, np.newaxis] >> np.arange(len(sizes)) & 1
        sums = (2.0 * combinations - 1.0) @ sizes
        return float(np.mean(sums >= seen - _ROUNDING))
    rng = np.random.Generator(np.random.PCG64(len(sizes)))
    signs = 2.0 * rng.integers(0, 2, (_DRAWS, len(sizes))) - 1.0
    return float((1 + np.sum(signs @ sizes >= seen - _ROUNDING)) / (1 + _DRAWS))
