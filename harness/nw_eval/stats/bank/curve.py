"""What a gate convicts, passes and leaves open, and after how many trials.

All by `simulate`. Between the margins either verdict is legitimate, so that what a gate is worth
stands in no single number, but in this curve.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from nw_eval.stats.bank.simulate import Against, chances_of, draw, success_of
from nw_eval.stats.bank.trials import TrialRules, TrialRuling, settle_all
from nw_eval.stats.courses import SceneCounts

DROPS = (0.0, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.07, 0.08, 0.1, 0.12, 0.15, 0.2, 0.25, 0.3)
"""Of the curve: closer where the verdict turns."""

REPETITIONS = 1000
"""The standard error of a share is at most 1.6 %."""


@dataclass(frozen=True, kw_only=True)
class CurvePoint:
    """Shares of simulated gates of policies whose true success is `drop` below the baseline's."""

    drop: float
    passed: float
    regressed: float
    trials: float
    """Mean number that were judged, of the candidate alone where a control runs beside it."""

    @property
    def undecided(self) -> float:
        """Share that the budget left open."""
        return max(0.0, 1.0 - self.passed - self.regressed)


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Shares of simulated gates that have ended after 1, 2, ... trials were judged."""

    passed: tuple[float, ...]
    regressed: tuple[float, ...]

    @property
    def settled(self) -> tuple[float, ...]:
        """Of either verdict."""
        return tuple(a + b for a, b in zip(self.passed, self.regressed, strict=True))


def trials_for(shares: Sequence[float], share: float) -> int | None:
    """Return after how many trials a share of a `Progress` is first reached; None if it never is.

    Args:
        shares: after 1, 2, ... trials.
        share: to reach, from 0 to 1.
    """
    return next((number for number, found in enumerate(shares, 1) if found >= share), None)


def operating_curve(
    seen: Sequence[SceneCounts],
    rules: TrialRules,
    *,
    budget: int,
    starts: int | None = None,
    drops: Sequence[float] = DROPS,
    repetitions: int = REPETITIONS,
    against: Against = "fresh",
) -> tuple[CurvePoint, ...]:
    """Return how a gate ends at each drop that the baseline is high enough for.

    Args:
        seen: the baseline's trials, waypoints reached in each scene. Without `starts` they are the
            bank itself, with as many in each scene.
        rules: of the gate.
        budget: most trials, no more than the bank has pairs of a scene and a start.
        starts: M of a bank that is not there yet. Banks are then drawn, one a repetition, from what
            was seen, as if the success that was seen were the true one.
        drops: of true success, scenes weighted equally.
        repetitions: simulated gates at each drop.
        against: what the gate compares with.

    Raises:
        ValueError: scenes have unequal numbers of starts, or fewer than the budget needs.
    """
    drawn = draw(seen, starts=starts, budget=budget, repetitions=repetitions, against=against)
    mean, points = success_of(seen), list[CurvePoint]()
    for drop in drops:
        if mean - drop > 0.0:
            chances = chances_of(seen, mean - drop)
            rulings = settle_all(drawn.bank, drawn.trials(chances), rules)
            words = [ruling.word for ruling in rulings]
            points.append(
                CurvePoint(
                    drop=drop,
                    passed=words.count("PASS") / len(words),
                    regressed=words.count("REGRESSED") / len(words),
                    trials=float(np.mean([ruling.trials for ruling in rulings])),
                )
            )
    return tuple(points)


def progress_at(
    seen: Sequence[SceneCounts],
    rules: TrialRules,
    drop: float,
    *,
    starts: int | None = None,
    repetitions: int = REPETITIONS,
    against: Against = "fresh",
) -> Progress:
    """Return how gates of a policy of this drop end if all starts of the bank may be run.

    Args:
        seen: as for `operating_curve`.
        rules: of the gate.
        drop: below the baseline's success.
        starts: as for `operating_curve`.
        repetitions: simulated gates.
        against: what the gate compares with.

    Raises:
        ValueError: scenes have unequal numbers of starts, or no policy can drop by so much.
    """
    budget = len(seen) * (seen[0].trials if starts is None else starts)
    chances = chances_of(seen, success_of(seen) - drop)
    drawn = draw(seen, starts=starts, budget=budget, repetitions=repetitions, against=against)
    rulings = settle_all(drawn.bank, drawn.trials(chances), rules)
    return progress_of(rulings, [ruling.trials for ruling in rulings], budget)


def progress_of(rulings: Sequence[TrialRuling], trials: Sequence[int], most: int) -> Progress:
    """Return the shares that have ended after each trial.

    Args:
        rulings: of the repetitions.
        trials: after how many, 1 to `most`, each was judged; not looked at where it is undecided.
        most: how many to tell of.
    """

    def shares(word: str) -> tuple[float, ...]:
        after = [
            count for ruling, count in zip(rulings, trials, strict=True) if ruling.word == word
        ]
        ended = np.bincount(after, minlength=most + 1)[1:]
        return tuple(count / len(rulings) for count in accumulate(ended.tolist()))

    return Progress(passed=shares("PASS"), regressed=shares("REGRESSED"))
