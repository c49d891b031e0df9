"""What a gate convicts, passes and leaves open, and after how many rounds.

All by `simulate`. Between the margins either verdict is legitimate, so that what a gate is worth
stands in no single number, but in this curve.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate

import numpy as np

from nw_eval.stats.bank.panel import Places
from nw_eval.stats.bank.simulate import GateRules, chances_of, draw, judge_all, success_of
from nw_eval.stats.courses import SceneCounts

DROPS = tuple(hundredths / 100 for hundredths in range(0, 31, 2))
"""Of the curve, .00 to .30."""

REPETITIONS = 1000
"""The standard error of a share is at most 1.6 %."""


@dataclass(frozen=True, kw_only=True)
class CurvePoint:
    """Shares of simulated gates of policies whose true success is `drop` below the baseline's."""

    drop: float
    passed: float
    regressed: float
    rounds: float
    """Mean number that were run."""

    @property
    def undecided(self) -> float:
        """Share that the budget left open."""
        return max(0.0, 1.0 - self.passed - self.regressed)


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Shares of simulated gates that have ended after 1, 2, ... rounds."""

    passed: tuple[float, ...]
    regressed: tuple[float, ...]

    @property
    def settled(self) -> tuple[float, ...]:
        """Of either verdict."""
        return tuple(a + b for a, b in zip(self.passed, self.regressed, strict=True))


def rounds_for(shares: Sequence[float], share: float) -> int | None:
    """Return after how many rounds a share of a `Progress` is first reached; None if it never is.

    Args:
        shares: after 1, 2, ... rounds.
        share: to reach, from 0 to 1.
    """
    return next((number for number, found in enumerate(shares, 1) if found >= share), None)


def operating_curve(
    seen: Sequence[SceneCounts],
    rules: GateRules,
    *,
    starts: int | None = None,
    drops: Sequence[float] = DROPS,
    repetitions: int = REPETITIONS,
) -> tuple[CurvePoint, ...]:
    """Return how a gate ends at each drop that the baseline is high enough for.

    Args:
        seen: the baseline's trials, waypoints reached in each scene. Without `starts` they are the
            bank itself, with as many in each scene.
        rules: of the gate; it has no more rounds than the bank has starts.
        starts: M of a bank that is not there yet. Banks are then drawn, one a repetition, from what
            was seen, as if the success that was seen were the true one.
        drops: of true success, scenes weighted equally.
        repetitions: simulated gates at each drop.

    Raises:
        ValueError: scenes have unequal numbers of starts, or fewer than rounds are asked for.
    """
    drawn = draw(seen, starts=starts, rounds=rules.rounds, repetitions=repetitions)
    mean, points = success_of(seen), list[CurvePoint]()
    for drop in drops:
        if mean - drop > 0.0:
            endings = judge_all(drawn, chances_of(seen, mean - drop), rules)
            points.append(
                CurvePoint(
                    drop=drop,
                    passed=float((endings.passed > 0).mean()),
                    regressed=float((endings.convicted > 0).mean()),
                    rounds=float(endings.rounds.mean()),
                )
            )
    return tuple(points)


def progress_at(
    seen: Sequence[SceneCounts],
    rules: GateRules,
    drop: float,
    *,
    starts: int | None = None,
    repetitions: int = REPETITIONS,
) -> Progress:
    """Return how gates of a policy of this drop end, if as many rounds are run as there are starts.

    Args:
        seen: as for `operating_curve`.
        rules: of the gate; their number of rounds is not looked at.
        drop: below the baseline's success.
        starts: as for `operating_curve`.
        repetitions: simulated gates.

    Raises:
        ValueError: scenes have unequal numbers of starts, or no policy can drop by so much.
    """
    rounds = seen[0].trials if starts is None else starts
    drawn = draw(seen, starts=starts, rounds=rounds, repetitions=repetitions)
    chances = chances_of(seen, success_of(seen) - drop)
    endings = judge_all(drawn, chances, replace(rules, rounds=rounds))
    return progress_of(endings.passed, endings.convicted, rounds)


def progress_of(passed: Places, convicted: Places, rounds: int) -> Progress:
    """Return the shares that have ended after each round.

    Args:
        passed: after which round each repetition passed, 0 where none, shape (repetitions,).
        convicted: likewise of REGRESSED.
        rounds: how many to tell of.
    """

    def shares(after: Places) -> tuple[float, ...]:
        ended = np.bincount(after, minlength=rounds + 1)[1:]
        return tuple(count / len(after) for count in accumulate(ended.tolist()))

    return Progress(passed=shares(passed), regressed=shares(convicted))
