"""Three figures of how well a simulator says which policy does better on the robot.

Each takes the success of N policies on the robot and in the simulator; their last axes are one set
of policies, and what comes before them many sets at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
FigureName = Literal["pearson", "spearman", "mmrv"]


def pearson(real: Floats, simulated: Floats) -> Floats:
    """Return the correlation coefficient of Pearson, shape (...) from (..., N), within [-1, 1].

    NaN where either side is the same for all policies.
    """
    x, y = (each - each.mean(axis=-1, keepdims=True) for each in (real, simulated))
    # What is equal may differ by rounding from its mean, and would correlate with anything.
    same = (np.ptp(real, axis=-1) == 0.0) | (np.ptp(simulated, axis=-1) == 0.0)
    spread = np.sqrt((x * x).sum(axis=-1) * (y * y).sum(axis=-1))
    found = (x * y).sum(axis=-1) / np.where(same, 1.0, spread)
    return np.where(same, np.nan, np.clip(found, -1.0, 1.0))


def spearman(real: Floats, simulated: Floats) -> Floats:
    """Return Spearman's rank correlation, as `pearson`; equal policies share their mean rank.

    Source: C. Spearman, "The proof and measurement of association between two things", Am. J.
    Psychol. 15 (1904).
    """
    return pearson(_ranks(real), _ranks(simulated))


def mmrv(real: Floats, simulated: Floats) -> Floats:
    """Return the mean maximum rank violation, shape (...) from (..., N), 0 (best) to 1.

    For each policy i, the largest real difference |R_i - R_j| to a policy j that the simulator
    orders otherwise, (S_i > S_j) != (R_i > R_j); the mean over i. It grows with N, so that only
    sets of equally many policies have comparable ones.

    Source: X. Li et al., "Evaluating Real-World Robot Manipulation Policies in Simulation"
    (SimplerEnv), arXiv 2405.05941; of policies that the simulator holds equal the
    better one is charged, as in the authors' published code.
    """
    above = real[..., :, None] > real[..., None, :]
    violated = above != (simulated[..., :, None] > simulated[..., None, :])
    differences = np.abs(real[..., :, None] - real[..., None, :])
    return np.where(violated, differences, 0.0).max(axis=-1).mean(axis=-1)


FIGURES: Mapping[FigureName, Callable[[Floats, Floats], Floats]] = MappingProxyType(
    {"pearson": pearson, "spearman": spearman, "mmrv": mmrv}
)


def _ranks(values: Floats) -> Floats:
    """Return ranks from 1, the mean of theirs for equal values."""
    below = (values[..., :, None] > values[..., None, :]).sum(axis=-1)
    equal = (values[..., :, None] == values[..., None, :]).sum(axis=-1)
    return below + (equal + 1.0) / 2.0
