"""All that can be said of how a simulator agrees with a robot, and no more.

Worked example: what is published of LucidSim in Neverwhere's scenes (arXiv 2609.16443), one
policy for hurdles, 15 of 20 trials on the robot and 15 of 20 simulated, and one for stairs, 12 of
20 and 17 of 20. Two points always lie on a line, so that a correlation of them is 1, -1 or none;
`agreement` gives none, and what can be said: the simulator's success less the robot's is .00 (-.26
to .26) on hurdles and .25 (-.03 to .48) on stairs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nw_eval.plural import plural
from nw_eval.stats.agreement.figures import FIGURES, FigureName
from nw_eval.stats.agreement.floor import Floor, likely_rates, perfect_simulator
from nw_eval.stats.agreement.jackknife import FEWEST, jackknife
from nw_eval.stats.binomial import newcombe
from nw_eval.stats.interval import Interval, check_confidence


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
    """Newcombe's, for this policy alone; rather too wide where trials score between 0 and 1."""


@dataclass(frozen=True, kw_only=True)
class Agreement:
    """Sim-to-real agreement; a figure that cannot be had is left out, and `remarks` say why."""

    policies: int
    confidence: float
    figures: tuple[AgreementFigure, ...]
    gaps: tuple[Gap, ...]
    remarks: tuple[str, ...]


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
    figures, remarks = _figures(measured, confidence)
    return Agreement(
        policies=len(measured),
        confidence=confidence,
        figures=tuple(figures),
        gaps=gaps,
        remarks=tuple(remarks),
    )


def _figures(
    measured: Sequence[Measured], confidence: float
) -> tuple[list[AgreementFigure], list[str]]:
    """Return the figures that can be had, and why others cannot."""
    if len(measured) < FEWEST:
        count = plural(len(measured), "policy", "policies")
        return [], [
            f"nothing can be said of rank or correlation from {count}: at least {FEWEST} are needed"
        ]
    real, simulated = (
        np.array([getattr(each, side) for each in measured], dtype=np.float64)
        for side in ("real", "simulated")
    )
    trials = (
        np.array([each.real_trials for each in measured], dtype=np.int64),
        np.array([each.simulated_trials for each in measured], dtype=np.int64),
    )
    floors = perfect_simulator(likely_rates(real, simulated, *trials), *trials)
    figures: list[AgreementFigure] = []
    for name, figure in FIGURES.items():
        interval = jackknife(name, real, simulated, confidence)
        if interval is not None:
            value = float(figure(real, simulated))
            figures.append(
                AgreementFigure(name=name, value=value, interval=interval, perfect=floors[name])
            )
    sides = (("on the robot", real), ("in the simulator", simulated))
    return figures, [
        f"nothing can be said of correlation: all policies did equally well {where}"
        for where, success in sides
        if np.ptp(success) == 0.0
    ]


def _check(measured: Sequence[Measured]) -> None:
    if len({each.policy for each in measured}) < len(measured):
        raise ValueError("a policy is there twice")
    for each in measured:
        if not (0.0 <= each.real <= 1.0 and 0.0 <= each.simulated <= 1.0):
            raise ValueError(f"success of policy {each.policy!r} is not between 0 and 1")
        if min(each.real_trials, each.simulated_trials) < 1:
            raise ValueError(f"policy {each.policy!r} has no trials")
