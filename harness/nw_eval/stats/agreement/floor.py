"""What the figures are of a perfect simulator, in which every policy has the robot's own rates.

A policy of true success p shows k / n in n trials, and does so anew on the robot and in the
simulator. That alone keeps the correlations below 1 and MMRV above 0, the more so the fewer the
trials and the closer the policies to each other. A simulator whose figures are no worse than that
cannot be told from a perfect one.

Ten policies of true success .3 to .9 in equal steps, 10 trials each on the robot and 160 in the
simulator (16 scenes of 10), show MMRV .129 in the mean and up to .24 in 95 %, Pearson .81. With 10
trials in the simulator too, and rates anywhere from 0 to 1, it is .167, .32 and .82.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256

import numpy as np
from numpy.typing import NDArray

from nw_eval.stats.agreement.figures import FIGURES, FigureName, Floats

Counts = NDArray[np.int64]
DRAWS = 4000
"""Simulated sets of policies: the standard error of a mean MMRV is about .001."""


@dataclass(frozen=True, kw_only=True)
class Floor:
    """One figure of perfect simulators."""

    mean: float
    worst: float
    """All but the worst 5 % are at least as good as this."""


def perfect_simulator(
    rates: Floats, real_trials: Counts, simulated_trials: Counts
) -> Mapping[FigureName, Floor]:
    """Return what perfect simulators show of N policies; the same for the same numbers, bit by bit.

    Sets in which a figure does not exist, all successes being equal, are left out of it.

    Args:
        rates: true success of the policies, shape (N,), or draws of it, shape (D, N).
        real_trials: of each policy on the robot, shape (N,).
        simulated_trials: of each policy in the simulator, shape (N,).

    Raises:
        ValueError: a rate is not within [0, 1], or a policy has no trials.
    """
    if not ((rates >= 0.0) & (rates <= 1.0)).all():
        raise ValueError("a true success is not between 0 and 1")
    if real_trials.min() < 1 or simulated_trials.min() < 1:
        raise ValueError("a policy without trials has no success")
    rng = seeded(rates, real_trials, simulated_trials)
    shape = (DRAWS, len(real_trials))
    chosen = rates if rates.ndim == 1 else rates[rng.integers(0, len(rates), DRAWS)]
    chosen = np.broadcast_to(chosen, shape)
    real = rng.binomial(real_trials, chosen) / real_trials
    simulated = rng.binomial(simulated_trials, chosen) / simulated_trials
    return {name: _floor(name, figure(real, simulated)) for name, figure in FIGURES.items()}


def likely_rates(
    real: Floats, simulated: Floats, real_trials: Counts, simulated_trials: Counts
) -> Floats:
    """Return draws of the true success of policies, shape (DRAWS, N), were the simulator perfect.

    Then both kinds of trials are of one rate, and after k successes in n of them it is distributed
    as Beta(1 + k, 1 + n - k); before any trial all rates are equally likely.

    Args:
        real: success on the robot, shape (N,).
        simulated: in the simulator, shape (N,).
        real_trials: of each policy on the robot, shape (N,).
        simulated_trials: of each policy in the simulator, shape (N,).
    """
    trials = real_trials + simulated_trials
    successes = real * real_trials + simulated * simulated_trials
    rng = seeded(real, simulated, real_trials, simulated_trials)
    return rng.beta(1.0 + successes, 1.0 + trials - successes, (DRAWS, len(trials)))


def seeded(*arrays: NDArray[np.float64] | NDArray[np.int64]) -> np.random.Generator:
    """Return random numbers that are decided by these arrays."""
    content = sha256(b"|".join(array.astype("<f8").tobytes() for array in arrays)).digest()
    return np.random.Generator(np.random.PCG64(int.from_bytes(content[:16], "little")))


def _floor(name: FigureName, values: Floats) -> Floor:
    known = values[np.isfinite(values)]
    if not known.size:
        return Floor(mean=float("nan"), worst=float("nan"))
    worst = np.quantile(known, 0.95 if name == "mmrv" else 0.05)
    return Floor(mean=float(known.mean()), worst=float(worst))
