"""Sim-to-real agreement: does the simulator say which policy does better on the robot?

Three figures of it take the success of N policies on the robot and in the simulator; their last
axes are one set of policies, and what comes before them many sets at once.

**What a perfect simulator shows**, in which every policy has the robot's own rates. A policy of
true success p shows k / n in n trials, and does so anew on the robot and in the simulator. That
alone keeps the correlations below 1 and MMRV above 0, the more so the fewer the trials and the
closer the policies to each other. A simulator whose figures are no worse than that cannot be told
from a perfect one. Ten policies of true success .3 to .9 in equal steps, 10 trials each on the
robot and 160 in the simulator (16 scenes of 10), show MMRV .129 in the mean and up to .24 in 95 %,
Pearson .81. With 10 trials in the simulator too, and rates anywhere from 0 to 1, it is .167, .32
and .82.

**Intervals of the figures** are what leaving out one policy at a time changes. The policies at hand
stand for more of their kind, each measured by as many trials, so policies are resampled and trials
are not: which policies one has is most of the uncertainty, and resampling trials alone covers 16 to
94 % where 95 % is meant. The interval is of what sets of N such policies show in the mean.

Each policy is left out once (Tukey's jackknife), on a scale on which the figure spreads evenly:
Fisher's z for correlations, the logarithm of (m + .01) / (1.01 - m) for MMRV. The interval is
Student's, with N - 1 degrees of freedom. Drawing policies with replacement does worse: from equal
policies come ties and perfect ranks that no set of N has, and the percentile intervals of MMRV
cover 46 to 74 %. Where leaving out any policy changes nothing, the spread is not zero but unseen,
and the interval is all of the range. Measured coverage of 95 %, with 5 to 20 policies of true
success .1 to .95 and simulators that are wrong about them by 0, .15 or .4 (standard deviation): 94
to 97 % for Pearson, 95 to 100 % for Spearman, 94 to 100 % for MMRV.

**Worked example**: what is published of LucidSim in Neverwhere's scenes (arXiv 2609.16443), one
policy for hurdles, 15 of 20 trials on the robot and 15 of 20 simulated, and one for stairs, 12 of
20 and 17 of 20. Two points always lie on a line, so that a correlation of them is 1, -1 or none;
`agreement` gives none, and what can be said: the simulator's success less the robot's is .00 (-.26
to .26) on hurdles and .25 (-.03 to .48) on stairs.

Source: J. W. Tukey, Ann. Math. Statist. 29 (1958) 614; R. G. Miller, "The jackknife - a review",
Biometrika 61 (1974), also on choosing the scale.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from math import sqrt
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from nw_base.plural import plural
from nw_gate.stats.interval import Interval, check_confidence, newcombe, t_quantile

Floats = NDArray[np.float64]
FigureName = Literal["pearson", "spearman", "mmrv"]


@dataclass(frozen=True, kw_only=True)
class Measured:
    """One policy's success in the two worlds: means of trials that score 0 to 1."""

    policy: str
    real: float
    real_trials: int
    simulated: float
    simulated_trials: int


@dataclass(frozen=True, kw_only=True)
class AgreementFigure:
    """One figure of agreement."""

    name: FigureName
    value: float
    interval: Interval
    """Of what sets of as many policies show in the mean: `jackknife`."""
    perfect: Floor
    """What perfect simulators show of policies like these, in as many trials."""


@dataclass(frozen=True, kw_only=True)
class Gap:
    """How much better one policy does in the simulator than on the robot."""

    policy: str
    value: float
    interval: Interval
    """Newcombe's, for this policy alone; rather too wide where trials score between 0 and 1. Of a
    limit, as `limits.with_robot` has it."""
    ladder: str = ""
    """Of a limit."""
    unit: str = ""
    """Of a limit."""


@dataclass(frozen=True, kw_only=True)
class Agreement:
    """Sim-to-real agreement; a figure that cannot be had is left out, and `remarks` say why."""

    policies: int
    confidence: float
    figures: tuple[AgreementFigure, ...]
    gaps: tuple[Gap, ...]
    remarks: tuple[str, ...]
    score: str = "success"
    """What was compared."""
    unit: str = ""
    """Of the gaps."""


def agreement(measured: Sequence[Measured], confidence: float = 0.95) -> Agreement:
    """Return how well a simulator ranks policies as the robot does.

    Args:
        measured: each policy once.
        confidence: two-sided, of every interval.

    Raises:
        ValueError: a success is not within [0, 1], a policy has no trials or is there twice, or
            the confidence is none.
    """
    check_confidence(confidence)
    _check(measured)
    gaps = tuple(
        Gap(
            policy=each.policy,
            value=each.simulated - each.real,
            interval=newcombe(
                (each.real * each.real_trials, each.real_trials),
                (each.simulated * each.simulated_trials, each.simulated_trials),
                confidence,
            ),
        )
        for each in measured
    )
    real, simulated = (
        np.array([getattr(each, side) for each in measured], dtype=np.float64)
        for side in ("real", "simulated")
    )
    trials = (
        np.array([each.real_trials for each in measured], dtype=np.int64),
        np.array([each.simulated_trials for each in measured], dtype=np.int64),
    )
    figures, remarks = figures_of(
        real,
        simulated,
        lambda: perfect_simulator(likely_rates(real, simulated, *trials), *trials),
        confidence,
    )
    return Agreement(
        policies=len(measured),
        confidence=confidence,
        figures=figures,
        gaps=gaps,
        remarks=remarks,
    )


def figures_of(
    real: Floats,
    simulated: Floats,
    perfect: Callable[[], Mapping[FigureName, Floor]],
    confidence: float,
) -> tuple[tuple[AgreementFigure, ...], tuple[str, ...]]:
    """Return the figures that can be had, and why others cannot.

    Args:
        real: of the policies on the robot, 0 to 1, shape (N,).
        simulated: of the same policies in the simulator, shape (N,).
        perfect: returns what perfect simulators show; not called for few policies.
        confidence: two-sided, of every interval.
    """
    if len(real) < FEWEST:
        count = plural(len(real), "policy", "policies")
        text = f"nothing can be said of rank or correlation from {count}"
        return (), (f"{text}: at least {FEWEST} are needed",)
    floors = perfect()
    figures: list[AgreementFigure] = []
    for name, figure in FIGURES.items():
        interval = jackknife(name, real, simulated, confidence)
        if interval is not None:
            value = float(figure(real, simulated))
            figures.append(
                AgreementFigure(name=name, value=value, interval=interval, perfect=floors[name])
            )
    sides = (("on the robot", real), ("in the simulator", simulated))
    return tuple(figures), tuple(
        f"nothing can be said of correlation: all policies did equally well {where}"
        for where, success in sides
        if np.ptp(success) == 0.0
    )


def _check(measured: Sequence[Measured]) -> None:
    if len({each.policy for each in measured}) < len(measured):
        raise ValueError("a policy is there twice")
    for each in measured:
        if not (0.0 <= each.real <= 1.0 and 0.0 <= each.simulated <= 1.0):
            raise ValueError(f"success of policy {each.policy!r} is not between 0 and 1")
        if min(each.real_trials, each.simulated_trials) < 1:
            raise ValueError(f"policy {each.policy!r} has no trials")


def pearson(real: Floats, simulated: Floats) -> Floats:
    """Return the correlation coefficient of Pearson, shape (...) from (..., N), within [-1, 1].

    NaN where either side is the same for all policies.
    """
    x, y = (each - each.mean(axis=-1, keepdims=True) for each in (real, simulated))
    # What is equal may differ by rounding from its mean, and would correlate with anything.
    same = (np.ptp(real, axis=-1) == 0.0) | (np.ptp(simulated, axis=-1) == 0.0)
    spread = np.sqrt((x * x).sum(axis=-1) * (y * y).sum(axis=-1))
    correlation = (x * y).sum(axis=-1) / np.where(same, 1.0, spread)
    return np.where(same, np.nan, np.clip(correlation, -1.0, 1.0))


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
    return floors_of(real, simulated)


def floors_of(real: Floats, simulated: Floats) -> Mapping[FigureName, Floor]:
    """Return the figures of draws of what perfect simulators show, both of shape (D, N)."""
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


FEWEST = 5
"""Policies. The interval of four still holds, and spans nine tenths of all there is."""

_NEAR = 0.9999  # A correlation of 1 without one policy is as far as this from the others.
_SMALL = 0.01  # Of MMRV: a tenth of a policy's success, in one of ten policies.


def jackknife(
    name: FigureName, real: Floats, simulated: Floats, confidence: float
) -> Interval | None:
    """Return the interval of a figure; None where the figure itself does not exist.

    Args:
        name: of the figure.
        real: success of N policies on the robot, shape (N,), N at least `FEWEST`.
        simulated: of the same policies in the simulator.
        confidence: two-sided.
    """
    figure, n = FIGURES[name], len(real)
    value = figure(real, simulated)
    if not np.isfinite(value):
        return None
    others = ~np.eye(n, dtype=bool)
    without = figure(
        *(np.broadcast_to(x, (n, n))[others].reshape(n, n - 1) for x in (real, simulated))
    )
    low, high = (0.0, 1.0) if name == "mmrv" else (-1.0, 1.0)
    if not np.isfinite(without).all() or np.ptp(without) < 1e-12:
        return Interval(low, high)
    scaled = _scaled(name, without)
    error = sqrt((n - 1) / n * float(((scaled - scaled.mean()) ** 2).sum()))
    middle, half = float(_scaled(name, value)), t_quantile(confidence, n - 1) * error
    ends = (_unscaled(name, end) for end in (middle - half, middle + half))
    return Interval(*(min(max(end, low), high) for end in ends))


def _scaled(name: FigureName, values: Floats) -> Floats:
    if name == "mmrv":
        return np.log((values + _SMALL) / (1.0 + _SMALL - values))
    return np.arctanh(np.clip(values, -_NEAR, _NEAR))


def _unscaled(name: FigureName, value: float) -> float:
    if name == "mmrv":
        return float((1.0 + 2 * _SMALL) / (1.0 + np.exp(-value)) - _SMALL)
    return float(np.tanh(value))
