"""Gates that were not run: a policy of a known drop, judged as a real one is, many times over.

Each is judged trial by trial with `settle_all`, critical scenes and the wait of PASS included.

What scores look like is taken from `stats.courses`: scenes keep their difficulty, and a worse
policy has the odds of the next waypoint, in all scenes, multiplied by one factor. Nothing ties the
candidate's trial to the baseline's from the same start, which is how it was measured to be once a
policy really changes, and which makes no verdict easier.

A repetition keeps its luck whatever the drop is: its order of scenes and starts, and how lucky each
trial is. So a larger drop fares worse in every repetition, and a curve over drops is smooth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from typing import Literal

import numpy as np

from nw_eval.stats.bank.panel import Bank, Floats, Places
from nw_eval.stats.bank.trials import DrawnTrials
from nw_eval.stats.courses import SceneCounts, chances_at

Against = Literal["fresh", "panel", "control"]
"""What a gate speaks of, and what it compares with. fresh: fresh starts, M is infinite; panel: the
bank's own starts alone; control: the baseline's policy, run beside the candidate."""


@dataclass(frozen=True, kw_only=True)
class Drawn:
    """Repetitions before anybody is judged: T trials each, in the order drawn."""

    bank: Bank
    """Of each, means of shape (repetitions, S); of a control, which has none, shape (S,)."""
    scenes: Places
    """Shape (repetitions, T)."""
    baseline: Floats
    """b of the same starts, shape (repetitions, T)."""
    luck: Floats
    """A trial reaches its i-th waypoint where this is below p^i, shape (repetitions, T)."""
    waypoints: Places
    """k, shape (S,)."""

    def trials(self, chances: Floats) -> DrawnTrials:
        """Return the trials of a policy of these chances.

        Args:
            chances: p, shape (S,), or (repetitions, S) for a policy of each.
        """
        candidate = scores_of(self.luck, chances, self.scenes, self.waypoints)
        return DrawnTrials(scenes=self.scenes, candidate=candidate, baseline=self.baseline)


def draw(
    seen: Sequence[SceneCounts],
    *,
    starts: int | None,
    budget: int,
    repetitions: int,
    against: Against = "fresh",
) -> Drawn:
    """Return repetitions of a gate against a baseline, the same ones for the same counts.

    Args:
        seen: the baseline's trials; without `starts` they are the bank itself, all of it.
        starts: M of the banks to be drawn, each anew, from what was seen of the baseline.
        budget: T, how many trials to draw; at most S x M.
        repetitions: how many.
        against: what the gate compares with.

    Raises:
        ValueError: scenes have unequal numbers of starts, or there are fewer than are to be drawn.
    """
    rng, waypoints = _rng(seen), np.array([len(course.counts) - 1 for course in seen])
    known = {course.trials for course in seen}
    if starts is None and len(known) > 1:
        raise ValueError(f"scenes with {min(known)} to {max(known)} starts are no baseline")
    size = known.pop() if starts is None else starts
    pairs = size * len(seen)
    if budget > pairs:
        raise ValueError(f"{budget} trials of {len(seen)} scenes with {size} starts each")
    order = np.array([rng.choice(pairs, budget, replace=False) for _ in range(repetitions)])
    scenes = order // size
    if starts is None:
        scores = np.array([np.repeat(course.values, course.counts) for course in seen])
        means = np.broadcast_to(scores.mean(axis=-1), (repetitions, len(seen)))
        baseline = scores.ravel()[order]
    else:
        chances, every = chances_of(seen, success_of(seen)), np.arange(pairs) // size
        panels = scores_of(rng.random((repetitions, pairs)), chances, every, waypoints)
        means = panels.reshape(repetitions, len(seen), size).mean(axis=-1)
        baseline = np.take_along_axis(panels, order, axis=-1)
    bank = Bank(means=means, starts=size)
    if against != "panel":
        bank = Bank.control(len(seen)) if against == "control" else bank.fresh()
    return Drawn(
        bank=bank,
        scenes=scenes,
        baseline=baseline,
        luck=rng.random((repetitions, budget)),
        waypoints=waypoints,
    )


def success_of(seen: Sequence[SceneCounts]) -> float:
    """Return mean success, scenes weighted equally."""
    return float(np.mean([course.counts @ course.values / course.trials for course in seen]))


def chances_of(seen: Sequence[SceneCounts], mean: float) -> Floats:
    """Return the chances of a policy with this true success, shape (S,); 1 is one that never fails.

    Raises:
        ValueError: the mean is not above 0.
    """
    return np.ones(len(seen)) if mean >= 1.0 else chances_at(list(seen), mean)


def scores_of(luck: Floats, chances: Floats, scenes: Places, waypoints: Places) -> Floats:
    """Return success of trials with this luck, of the shape of luck.

    Args:
        luck: from 0 to 1, shape (..., T).
        chances: p, shape (S,), or (..., S).
        scenes: of the trials, shape (..., T) or (T,).
        waypoints: k, shape (S,).
    """
    p = chances[scenes] if chances.ndim == 1 else np.take_along_axis(chances, scenes, axis=-1)
    k = waypoints[scenes]
    reached, power = np.zeros(luck.shape), np.ones_like(p)
    for number in range(1, int(waypoints.max()) + 1):
        power = power * p
        reached += (luck < power) & (number <= k)
    return reached / k


def _rng(seen: Sequence[SceneCounts]) -> np.random.Generator:
    """Return a generator that is seeded by what was seen."""
    content = sha256(b"".join(course.counts.astype("<i8").tobytes() + b"|" for course in seen))
    return np.random.Generator(np.random.PCG64(int.from_bytes(content.digest()[:16], "little")))
