"""How often runs that were not made would be passed or flagged by the bounds of `betting`.

A policy in a scene is a chance: that of reaching the next waypoint, whichever it is. With chance p
a trial ends after j of k waypoints with probability p^j (1 - p), and reaches all with p^k. That is
the simplest account of rows whose success is a share of waypoints reached in order; it gives trials
a spread between that of coins and that of shares, which decides how often a run of a given true
success passes a bar. Scenes differ in p; a better or worse policy has the odds p / (1 - p) of every
scene multiplied by one factor, as in Rasch's model of tests and their takers.

Runs are drawn from these chances and judged as real ones are. The draws are seeded by what was
seen, so the same rows forecast the same, digit by digit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from math import lgamma, log
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nw_gate.stats.betting import log_bets, log_mixture

Floats = NDArray[np.float64]

_STEPS = 60  # Halvings: beyond the precision of a double.


@dataclass(frozen=True, kw_only=True)
class SceneCounts:
    """What was seen in one scene."""

    counts: NDArray[np.int64]
    """Trials that ended with 0, 1, ..., k waypoints reached, shape (k + 1,) with k at least 1."""
    alone: bool = False
    """Whether the scene is also judged by itself."""

    @classmethod
    def of(
        cls, reached: Sequence[int], waypoints: Sequence[int], *, alone: bool = False
    ) -> SceneCounts:
        """Count trials by the waypoints that they reached, out of those that there were."""
        length = max(1, *waypoints) + 1
        return cls(counts=np.bincount(reached, minlength=length).astype(np.int64), alone=alone)

    @property
    def trials(self) -> int:
        """How many trials there were."""
        return int(self.counts.sum())

    @property
    def values(self) -> Floats:
        """The success that each number of waypoints is, shape (k + 1,)."""
        return np.linspace(0.0, 1.0, len(self.counts))

    @property
    def passed(self) -> int:
        """Waypoints that were reached, over all trials."""
        return int(self.counts @ np.arange(len(self.counts)))

    @property
    def failed(self) -> int:
        """Waypoints that were set out for and not reached: one for each trial that did not end."""
        return int(self.counts[:-1].sum())


def ends(chances: Floats, waypoints: int) -> Floats:
    """Return the probability of ending with 0 .. k waypoints, shape (..., k + 1)."""
    reached = chances[..., None] ** np.arange(waypoints + 1)
    return np.concatenate([reached[..., :-1] * (1.0 - chances[..., None]), reached[..., -1:]], -1)


def chances_at(courses: list[SceneCounts], mean: float) -> Floats:
    """Return the chances, shape (S,), of a policy whose success is `mean`, scenes weighted equally.

    The odds of all scenes as seen are multiplied by the one factor that gives this mean.

    Raises:
        ValueError: the mean is not between 0 and 1.
    """
    if not 0.0 < mean < 1.0:
        raise ValueError(f"mean success {mean} is not between 0 and 1")
    odds = np.array([passed / failed for passed, failed in _weights(courses)])
    waypoints = np.array([len(course.counts) - 1 for course in courses])
    steps = np.arange(1, waypoints.max() + 1)
    # Mean success is the mean over waypoints of the probability to reach each: p, p^2, ..., p^k.
    shares = (steps <= waypoints[:, None]) / waypoints[:, None]

    def at(power: float) -> Floats:
        raised = odds * np.exp(power)
        return raised / (1.0 + raised)

    low, high = -60.0, 60.0
    for _ in range(_STEPS):
        middle = (low + high) / 2
        chances = (shares * at(middle)[:, None] ** steps).sum() / len(courses)
        low, high = (middle, high) if chances < mean else (low, middle)
    return at(high)


def likely_chances(
    courses: list[SceneCounts], repetitions: int, rng: np.random.Generator
) -> Floats:
    """Return draws of what the chances may be after what was seen, shape (repetitions, S).

    Each scene's is a draw from its Beta distribution.
    """
    draws = [rng.beta(passed, failed, repetitions) for passed, failed in _weights(courses)]
    return np.stack(draws, axis=1)


_FACTORS = np.linspace(-6.0, 6.0, 241)
"""Logarithms of the factor by which a policy's odds may differ from the baseline's."""
_CLOSENESS = np.array([2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0])
"""How many waypoints of a scene the baseline and the other scenes may count for."""
_log_gamma = np.frompyfunc(lgamma, 1, 1)


def chances_beside(
    courses: Sequence[SceneCounts],
    baseline: Sequence[SceneCounts],
    repetitions: int,
    rng: np.random.Generator,
) -> Floats:
    """Return draws of what the chances may be, given a baseline's as well, shape (repetitions, S).

    The policy's odds are the baseline's times one factor in all scenes, about which each scene
    departs by itself: with m the chance in a scene at these odds, its own is Beta(a m, a (1 - m)).
    Beforehand the logarithms of the factor and of a are anything on a grid, equally likely. Both
    are drawn from their posterior, and then each scene's chance from its own. A scene that is
    waited for because it did worst did so by bad luck, too: what its few trials say is moved
    towards what the other scenes and the baseline say.

    Args:
        courses: what was seen of the policy; a scene may have no trial.
        baseline: what was seen of the baseline in the same scenes.
        repetitions: how many draws.
        rng: random generator.

    Source: A. Gelman et al., Bayesian Data Analysis, 3rd edition (2013), section 5.3.
    """
    # Half a waypoint each: no scene is so surely perfect that one failure there cannot be.
    odds = np.log([(course.passed + 0.5) / (course.failed + 0.5) for course in baseline])
    m = 1.0 / (1.0 + np.exp(-(odds + _FACTORS[:, None])))
    a = _CLOSENESS[:, None] * m[:, None, :]
    b = _CLOSENESS[:, None] - a
    passed, failed = (
        np.array([getattr(course, name) for course in courses]) for name in ("passed", "failed")
    )
    likelihood = (_log_beta(a + passed, b + failed) - _log_beta(a, b)).sum(axis=-1)
    weights = np.exp(likelihood - likelihood.max())
    which = rng.choice(weights.size, repetitions, p=weights.ravel() / weights.sum())
    factor, closeness = np.unravel_index(which, weights.shape)
    return rng.beta(a[factor, closeness] + passed, b[factor, closeness] + failed)


def _log_beta(a: Floats, b: Floats) -> Floats:
    one, other, both = (np.asarray(_log_gamma(x), np.float64) for x in (a, b, a + b))
    return one + other - both


def _weights(courses: list[SceneCounts]) -> list[tuple[float, float]]:
    """Return how often waypoints were passed and failed in each scene, and a little more.

    The little is half a waypoint each, shared among all scenes, as `bootstrap` shares its
    pseudo-trials: no scene is surely perfect, and half a waypoint in each would pull a suite's mean
    away from what was seen (by .015 for 16 scenes of ten trials at .80).
    """
    prior = 0.5 / len(courses)
    return [(course.passed + prior, course.failed + prior) for course in courses]


RUNS = 2000
"""Simulated runs: the standard error of a share is at most 1.1 %."""


class Shares(NamedTuple):
    """Of simulated runs."""

    passed: float
    regressed: float


def shares_at(courses: list[SceneCounts], mean: float, *, bar: float, confidence: float) -> Shares:
    """Return how often runs like this one end, of a policy whose true success is `mean`.

    Runs have the same scenes and as many trials in each, with fresh starts.

    Args:
        courses: what was seen; its scenes keep their relative difficulty.
        mean: true success, scenes weighted equally, between 0 and 1.
        bar: what the lower bound must reach, and the upper one must not miss.
        confidence: of each bound; scenes `alone` share what is left of it for theirs.
    """
    chances = np.broadcast_to(chances_at(courses, mean), (RUNS, len(courses)))
    return _judge([_draw(courses, chances, 1, seeded(courses))], courses, bar, confidence)


def shares_after(
    courses: list[SceneCounts], times: int, *, bar: float, confidence: float
) -> Shares:
    """Return how often this run ends so, once there are `times` as many trials in every scene.

    The true success is not known, but drawn anew for each simulated run from what it may be after
    what was seen; a share is the chance that this run has to be decided.
    """
    rng = seeded(courses)
    fresh = _draw(courses, likely_chances(courses, RUNS, rng), times - 1, rng)
    seen = [np.broadcast_to(course.counts, (RUNS, len(course.counts))) for course in courses]
    return _judge([fresh, seen], courses, bar, confidence)


def _runs_at(
    courses: list[SceneCounts],
    mean: float,
    *,
    stream: int,
    bar: float | None = None,
    confidence: float = 0.95,
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return what each of `RUNS` simulated runs shows: its mean success, and whether it passes.

    Args:
        courses: as for `shares_at`, and so are mean and confidence.
        mean: true success.
        stream: runs of another one are drawn independently.
        bar: without one no run passes.
        confidence: of the lower bound.
    """
    chances = np.broadcast_to(chances_at(courses, mean), (RUNS, len(courses)))
    counts = _draw(courses, chances, 1, seeded(courses, stream))
    shown = [n @ course.values / course.trials for n, course in zip(counts, courses, strict=True)]
    passed = np.zeros(RUNS, dtype=bool)
    if bar is not None:
        passed, _ = _judged([counts], courses, bar, confidence)
    return np.mean(shown, axis=0), passed


def seeded(courses: Sequence[SceneCounts], stream: int = 0) -> np.random.Generator:
    """Return random numbers that are decided by what was seen, and by the number of a stream."""
    content = sha256(b"".join(course.counts.astype("<i8").tobytes() + b"|" for course in courses))
    if stream:
        content.update(str(stream).encode())
    return np.random.Generator(np.random.PCG64(int.from_bytes(content.digest()[:16], "little")))


def _draw(
    courses: list[SceneCounts], chances: Floats, times: int, rng: np.random.Generator
) -> list[NDArray[np.int64]]:
    """Return counts of ends in each scene, shape (runs, k + 1)."""
    return [
        rng.multinomial(times * course.trials, ends(chances[:, index], len(course.counts) - 1))
        for index, course in enumerate(courses)
    ]


def _judge(
    parts: list[list[NDArray[np.int64]]], courses: list[SceneCounts], bar: float, confidence: float
) -> Shares:
    """Return how many runs pass and are flagged."""
    passed, regressed = _judged(parts, courses, bar, confidence)
    return Shares(float(passed.mean()), float(regressed.mean()))


def _judged(
    parts: list[list[NDArray[np.int64]]], courses: list[SceneCounts], bar: float, confidence: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which runs pass and are flagged; a run's counts are the sum of its parts."""
    counts = [np.sum(part, axis=0) for part in zip(*parts, strict=True)]
    trials = [int(ended[0].sum()) for ended in counts]
    above = below = np.zeros(1)
    flagged = np.zeros(len(counts[0]), dtype=bool)
    level = -log(1.0 - confidence)
    stricter = level + log(max(1, sum(course.alone for course in courses)))
    for course, ended, n in zip(courses, counts, trials, strict=True):
        # As `betting` weighs scenes of different lengths.
        share = min(trials) / n
        above = above + ended @ log_bets(course.values, share, bar).T
        below = below + ended @ log_bets(1.0 - course.values, share, 1.0 - bar).T
        if course.alone:
            alone = ended @ log_bets(1.0 - course.values, 1.0, 1.0 - bar).T
            flagged |= log_mixture(alone) >= stricter
    passed = (log_mixture(above) >= level) & ~flagged
    regressed = (log_mixture(below) >= level) | flagged
    return passed, regressed


@dataclass(frozen=True, kw_only=True)
class Luck:
    """What chance alone does for the best of some candidates of which none is better."""

    overstated: float
    """Mean over simulations of how much more the best shows than all truly are."""
    any_passes: float | None
    """Share of simulations in which at least one passes the bar; None without a bar."""


def luck_of_the_best(
    candidates: Sequence[list[SceneCounts]],
    truth: float,
    *,
    bar: float | None = None,
    confidence: float = 0.95,
) -> Luck:
    """Simulate candidates that are all equally good, each with as many trials as it had.

    Method: gate.md, "The absolute bar": with 50 checkpoints truly at the bar at least one passes in
    11 to 14 %, and the winner overstates by .04 to .06.

    Args:
        candidates: what was seen of each, by scene; scenes keep their relative difficulty.
        truth: the mean success of all of them, between 0 and 1.
        bar: what the lower bound of mean success must reach to pass.
        confidence: of that bound.

    Raises:
        ValueError: there are no candidates, or the truth is none.
    """
    if not candidates:
        raise ValueError("the best of no candidates")
    best, any_passes = np.zeros(RUNS), np.zeros(RUNS, dtype=bool)
    for stream, courses in enumerate(candidates, start=1):
        shown, passed = _runs_at(courses, truth, stream=stream, bar=bar, confidence=confidence)
        best, any_passes = np.maximum(best, shown), any_passes | passed
    return Luck(
        overstated=float(best.mean()) - truth,
        any_passes=None if bar is None else float(any_passes.mean()),
    )
