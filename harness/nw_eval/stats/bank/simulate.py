"""Gates that were not run: a policy of a known drop, judged as a real one is, many times over.

What scores look like is taken from `stats.courses`: scenes keep their difficulty, and a worse
policy has the odds of the next waypoint, in all scenes, multiplied by one factor. Nothing ties the
candidate's trial to the baseline's from the same start, which is how it was measured to be once a
policy really changes, and which makes no verdict easier.

A repetition keeps its luck whatever the drop is: its orders of starts, and how lucky each trial is.
So a larger drop fares worse in every repetition, and a curve over drops is smooth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from hashlib import sha256

import numpy as np

from nw_eval.stats.bank.decide import look
from nw_eval.stats.bank.evidence import Evidence, Margins
from nw_eval.stats.bank.panel import Bank, Floats, Places
from nw_eval.stats.courses import SceneCounts, chances_at
from nw_eval.words import Tier


@dataclass(frozen=True, kw_only=True)
class GateRules:
    """By what a gate decides."""

    tiers: tuple[Tier, ...]
    """Of the scenes, shape (S,), none of them informational."""
    margins: Margins = field(default_factory=Margins)
    alpha_pass: float = 0.05
    alpha_regr: float = 0.01
    rounds: int = 20
    """Most that are run."""


@dataclass(frozen=True, kw_only=True)
class Endings:
    """How the repetitions ended, each shape (repetitions,)."""

    passed: Places
    """After which round it passed; 0 where it never did."""
    convicted: Places
    """After which round it was convicted; 0 where it never was."""
    named: Places
    """How many scenes were named."""
    budget: int

    @property
    def rounds(self) -> Floats:
        """Rounds that were run."""
        after = self.passed + self.convicted
        return np.where(after, after, self.budget).astype(np.float64)


@dataclass(frozen=True, kw_only=True)
class Drawn:
    """Repetitions before anybody is judged."""

    bank: Bank
    """Of each, means of shape (repetitions, S)."""
    baseline: Floats
    """b in the order drawn, shape (repetitions, rounds, S)."""
    luck: Floats
    """A trial reaches its i-th waypoint where this is below p^i, shape (repetitions, rounds, S)."""
    waypoints: Places
    """k, shape (S,)."""

    def scores(self, chances: Floats, number: int, which: Places) -> Floats:
        """Return success in one round of a policy of these chances, (..., S), in some repetitions.

        Args:
            chances: p, shape (S,) or (repetitions, S).
            number: of the round, from 0.
            which: repetitions, by number.
        """
        luck = self.luck[which, number]
        p = chances[which] if chances.ndim > 1 else chances
        return _reached(luck, p, self.waypoints) / self.waypoints


@dataclass(frozen=True, kw_only=True)
class Before:
    """Rounds that were really run, before those that are simulated."""

    evidence: Evidence
    """After them, once for each repetition."""
    named: tuple[int, ...]
    """Scenes that fell."""


def draw(
    seen: Sequence[SceneCounts], *, starts: int | None, rounds: int, repetitions: int
) -> Drawn:
    """Return repetitions of a gate against a baseline, the same ones for the same counts.

    Args:
        seen: the baseline's trials; without `starts` they are the bank itself, all of it.
        starts: M of the banks to be drawn, each anew, from what was seen of the baseline.
        rounds: how many to draw; at most M.
        repetitions: how many.

    Raises:
        ValueError: scenes have unequal numbers of starts, or there are fewer than rounds.
    """
    rng, waypoints = _rng(seen), np.array([len(course.counts) - 1 for course in seen])
    known = {course.trials for course in seen}
    if starts is None and len(known) > 1:
        raise ValueError(f"scenes with {min(known)} to {max(known)} starts are no bank")
    size = known.pop() if starts is None else starts
    if rounds > size:
        raise ValueError(f"{rounds} rounds of a bank with {size} starts a scene")
    shape = (repetitions, size, len(seen))
    if starts is None:
        scores = np.array([np.repeat(course.values, course.counts) for course in seen])
        means = np.broadcast_to(scores.mean(axis=-1), (repetitions, len(seen)))
        panels = np.broadcast_to(scores, (repetitions, *scores.shape))
        baseline = rng.permuted(panels, axis=-1)[..., :rounds].swapaxes(1, 2)
    else:
        chances = chances_of(seen, success_of(seen))
        scores = _reached(rng.random(shape), chances, waypoints) / waypoints
        means, baseline = scores.mean(axis=1), scores[:, :rounds]
    return Drawn(
        bank=Bank(means=means, starts=size),
        baseline=baseline,
        luck=rng.random((repetitions, rounds, len(seen))),
        waypoints=waypoints,
    )


def judge_all(
    drawn: Drawn, chances: Floats, rules: GateRules, before: Before | None = None
) -> Endings:
    """Return how repetitions end for a policy of these chances.

    Args:
        drawn: the repetitions.
        chances: shape (S,), or (repetitions, S) for a policy of each.
        rules: by which they are judged.
        before: what is known when they begin; None if they begin with the first round.
    """
    repetitions, budget = drawn.luck.shape[0], min(drawn.luck.shape[1], rules.rounds)
    evidence = before.evidence if before else Evidence.before(drawn.bank, rules.margins)
    named = np.zeros((repetitions, len(rules.tiers)), dtype=bool)
    named[:, before.named if before else []] = True
    going = np.arange(repetitions)
    passed, convicted, count = np.zeros((3, repetitions), dtype=np.intp)
    for number in range(budget):
        scores = drawn.scores(chances, number, going)
        evidence = evidence.after(scores, drawn.baseline[going, number])
        seen = look(
            evidence.values,
            named,
            rules.tiers,
            alpha_pass=rules.alpha_pass,
            alpha_regr=rules.alpha_regr,
        )
        passed[going[seen.passes]] = number + 1
        convicted[going[seen.convicts]] = number + 1
        count[going] = seen.named.sum(axis=-1)
        (stay,) = np.nonzero(~(seen.passes | seen.convicts))
        going, named, evidence = going[stay], seen.named[stay], evidence.only(stay)
        if not going.size:
            break
    return Endings(passed=passed, convicted=convicted, named=count, budget=budget)


def success_of(seen: Sequence[SceneCounts]) -> float:
    """Return mean success, scenes weighted equally."""
    return float(np.mean([course.counts @ course.values / course.trials for course in seen]))


def chances_of(seen: Sequence[SceneCounts], mean: float) -> Floats:
    """Return the chances of a policy with this true success, shape (S,); 1 is one that never fails.

    Raises:
        ValueError: the mean is not above 0.
    """
    return np.ones(len(seen)) if mean >= 1.0 else chances_at(list(seen), mean)


def _reached(luck: Floats, chances: Floats, waypoints: Places) -> Floats:
    """Return how many waypoints are reached, (..., S): i of them with probability p^i."""
    reached, power = np.zeros(luck.shape), np.ones_like(chances)
    for number in range(1, int(waypoints.max()) + 1):
        power = power * chances
        reached += luck < np.where(number <= waypoints, power, 0.0)
    return reached


def _rng(seen: Sequence[SceneCounts]) -> np.random.Generator:
    """Return a generator that is seeded by what was seen."""
    content = sha256(b"".join(course.counts.astype("<i8").tobytes() + b"|" for course in seen))
    return np.random.Generator(np.random.PCG64(int.from_bytes(content.digest()[:16], "little")))
