"""The bank: what the baseline scores from every start, known because simulation repeats its bits.

There are S scenes with M starts each. b_si is the baseline's success from start i of scene s, B_s
its mean over the starts of scene s, and B the mean of all B_s; c_si is the candidate's success.

The candidate is judged by c less what is known of the starts' difficulty:

    z_si = c_si - g_si + B,     g_si = B_s + beta (b_si - B_s),     0 <= beta <= 1.

Over the panel the mean of g is B, so that z has the candidate's mean whatever beta is. Within a
scene z varies less than c as far as the two policies find the same starts hard.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Places = NDArray[np.intp]
Truths = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class Bank:
    """What must be known of the whole panel before the first trial.

    Raises:
        ValueError: a mean is not between 0 and 1, there is no scene, or not one start.
    """

    means: Floats
    """B_s, shape (S,); leading axes, if any, are of gates apart."""
    starts: float = inf
    """M; infinite for a claim about fresh starts, so that no draw leaves less for the rest."""
    paired: bool = False
    """Whether b is what the baseline's policy scored beside the candidate, from the same start and
    on the same machine (a concurrent control). Then c - b alone counts, and no mean of a bank: z =
    c - b + B, which is 1 + c - b above its least, whatever B is."""

    def __post_init__(self) -> None:
        if self.means.ndim < 1 or not self.means.shape[-1]:
            raise ValueError("a baseline needs the mean of one scene at least")
        check_successes(self.means)
        if not self.starts >= 1:
            raise ValueError(f"{self.starts} starts in each scene; a baseline needs one at least")

    @classmethod
    def of(cls, scores: Floats) -> Bank:
        """Return the bank of the baseline's successes b_si on the whole panel, shape (S, M)."""
        check_successes(scores)
        return cls(means=scores.mean(axis=-1), starts=scores.shape[-1])

    @classmethod
    def control(cls, scenes: int) -> Bank:
        """Return what stands for the bank of a concurrent control of S scenes: no mean of it."""
        return cls(means=np.ones(scenes), paired=True)

    def fresh(self) -> Bank:
        """Return the bank for a claim about fresh starts: M is infinite."""
        return replace(self, starts=inf)

    @property
    def betas(self) -> tuple[float, ...]:
        """How much of a start's own difficulty is used, once for each gambler."""
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
