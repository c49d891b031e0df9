"""Limits in the simulator beside those on the robot, as `stats.agreement` has success.

**Gaps** are in the ladder's unit. A limit is the value at which a policy's share of completed
trials crosses the share of the search. In the simulator its point is the posterior mean, and its
bounds those of the search at half the error each. On the robot the point is the limit, or midway
between the hardest value that was cleared and the easiest one that was not; these two are taken for
certain. The interval of a gap has all differences of both ranges, and is open where a bound lacks.

**Figures** take each policy's mean over its ladders, on which the easiest rung is 0 and the hardest
is 1; what lies beyond counts as 0 or 1. Perfect simulators have limits midway between both points.
Those that they show differ from them as the posterior is spread, and the robot's evenly between its
two values.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf

import numpy as np
from numpy.typing import NDArray

from nw_gate.limits.curves import Curves
from nw_gate.limits.limit import Limit
from nw_gate.stats.agreement import (
    DRAWS,
    Agreement,
    FigureName,
    Floor,
    Gap,
    figures_of,
    floors_of,
    seeded,
)
from nw_gate.stats.interval import Interval, check_confidence

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class MeasuredLimit:
    """A policy's limit on one ladder in the two worlds."""

    policy: str
    ladder: str
    simulated: Limit
    lower: float | None
    """The hardest value that was cleared on the robot."""
    upper: float | None
    """The easiest value that was not; one of both is a number."""


def agreement_of_limits(measured: Sequence[MeasuredLimit], confidence: float = 0.95) -> Agreement:
    """Return how well simulated limits agree with those on the robot.

    Args:
        measured: each policy and ladder once.
        confidence: two-sided, of every interval.

    Raises:
        ValueError: the confidence is none.
    """
    check_confidence(confidence)
    names = list(dict.fromkeys(each.policy for each in measured))
    gaps = tuple(_gap(each, confidence) for each in measured)
    points = {id(each): (_robots(each), _simulated(each.simulated)) for each in measured}
    groups = [[each for each in measured if each.policy == name] for name in names]
    real, simulated = (
        np.array(
            [np.mean([_scaled(x, points[id(x)][side]) for x in group]) for group in groups],
            np.float64,
        )
        for side in (0, 1)
    )

    def perfect() -> Mapping[FigureName, Floor]:
        rng = seeded(real, simulated)
        shown = [[_shown(x, *points[id(x)], rng) for x in group] for group in groups]
        robot, simulator = (
            np.stack([np.mean([pair[side] for pair in each], axis=0) for each in shown], axis=-1)
            for side in (0, 1)
        )
        return floors_of(robot, simulator)

    figures, remarks = figures_of(real, simulated, perfect, confidence)
    return Agreement(
        policies=len(names),
        confidence=confidence,
        figures=figures,
        gaps=gaps,
        remarks=remarks,
        score="limit",
    )


def _gap(each: MeasuredLimit, confidence: float) -> Gap:
    limit = each.simulated
    ends = limit.wealth.bounds(0.5 + confidence / 2.0)
    ours = _span(limit, *(int(end[0]) for end in ends))
    sign = 1.0 if limit.ladder.rises else -1.0
    theirs = (
        -inf if each.lower is None else sign * each.lower,
        inf if each.upper is None else sign * each.upper,
    )
    low, high = sorted((sign * (ours[0] - theirs[1]), sign * (ours[1] - theirs[0])))
    return Gap(
        policy=each.policy,
        value=_simulated(limit) - _robots(each),
        interval=Interval(low, high),
        ladder=each.ladder,
        unit=limit.ladder.unit,
    )


def _span(limit: Limit, low: int, high: int) -> tuple[float, float]:
    """Return the bounds by hardness; infinite off the ladder."""
    values = limit.ladder.hardness
    return (
        values[low] if low >= 0 else -inf,
        values[high] if high < len(values) else inf,
    )


def _mass(limit: Limit) -> tuple[Floats, Floats]:
    """Return the values that a limit may have, and the probability of each, both (n + 1,)."""
    rungs = np.array(limit.ladder.rungs)
    values = np.concatenate([rungs[:1], (rungs[:-1] + rungs[1:]) / 2.0, rungs[-1:]])
    curves = Curves.over(len(rungs), limit.share)
    mass = curves.beliefs(limit.wealth.done, limit.wealth.missed).cleared[0]
    return values, mass / mass.sum()


def _simulated(limit: Limit) -> float:
    """Return the posterior mean of a limit."""
    values, mass = _mass(limit)
    return float(values @ mass)


def _robots(each: MeasuredLimit) -> float:
    known = [value for value in (each.lower, each.upper) if value is not None]
    return sum(known) / len(known)


def _scaled(each: MeasuredLimit, value: float | Floats) -> Floats:
    """Return a value on its ladder, from 0 for the easiest rung to 1 for the hardest."""
    rungs = each.simulated.ladder.rungs
    return np.clip((np.asarray(value) - rungs[0]) / (rungs[-1] - rungs[0]), 0.0, 1.0)


def _shown(
    each: MeasuredLimit, robots: float, simulated: float, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Return what a robot and a perfect simulator show of one limit, both (DRAWS,)."""
    values, mass = _mass(each.simulated)
    middle = (robots + simulated) / 2.0
    half = 0.0
    if each.lower is not None and each.upper is not None:
        half = abs(each.upper - each.lower) / 2.0
    errors = values[rng.choice(len(values), DRAWS, p=mass)] - simulated
    return (
        _scaled(each, middle + half * rng.uniform(-1.0, 1.0, DRAWS)),
        _scaled(each, middle + errors),
    )
