"""A policy in a scene as a chance: that of reaching the next waypoint, whichever it is.

With chance p a trial ends after j of k waypoints with probability p^j (1 - p), and reaches all with
p^k. That is the simplest account of rows whose success is a share of waypoints reached in order; it
gives trials a spread between that of coins and that of shares, which decides how often a run of a
given true success passes a bar. Scenes differ in p; a better or worse policy has the odds
p / (1 - p) of every scene multiplied by one factor, as in Rasch's model of tests and their takers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
        found = (shares * at(middle)[:, None] ** steps).sum() / len(courses)
        low, high = (middle, high) if found < mean else (low, middle)
    return at(high)


def likely_chances(
    courses: list[SceneCounts], repetitions: int, rng: np.random.Generator
) -> Floats:
    """Return draws of what the chances may be after what was seen, shape (repetitions, S).

    Each scene's is a draw from its Beta distribution.
    """
    draws = [rng.beta(passed, failed, repetitions) for passed, failed in _weights(courses)]
    return np.stack(draws, axis=1)


def _weights(courses: list[SceneCounts]) -> list[tuple[float, float]]:
    """Return how often waypoints were passed and failed in each scene, and a little more.

    The little is half a waypoint each, shared among all scenes, as `bootstrap` shares its
    pseudo-trials: no scene is surely perfect, and half a waypoint in each would pull a suite's mean
    away from what was seen (by .015 for 16 scenes of ten trials at .80).
    """
    prior = 0.5 / len(courses)
    return [(course.passed + prior, course.failed + prior) for course in courses]
