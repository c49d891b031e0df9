"""Success of one policy along one axis, and the values at which it breaks off.

The cliff is not the steepest piece of a noisy line. The value nearest to the neutral one is the
reference; going outwards from it on each side, the cliff is the first value at which fewer trials
complete than there beyond chance: Fisher's exact test with scenes as strata, Bonferroni over all
values that are compared. What chance may explain is no cliff, and is said to be none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nw_eval.results.row import Row
from nw_eval.stats import Interval, mean_of_scenes
from nw_eval.stats.binomial import fisher
from nw_eval.suite.perturb import NEUTRAL

_BUILT_FRICTION = 1.25
"""At which feet slide where nothing is changed."""


@dataclass(frozen=True, kw_only=True)
class Point:
    """One value of an axis.

    Attributes:
        value: of the axis.
        mean: success over scenes, 0..1; None without a result.
        interval: of the mean, alone.
        completed: trials that reached all waypoints, and all trials with a result, by scene.
        errors: trials without a result.
    """

    value: float
    mean: float | None
    interval: Interval
    completed: dict[str, tuple[int, int]]
    errors: int

    @property
    def trials(self) -> int:
        """How many came to a result."""
        return sum(n for _, n in self.completed.values())

    @property
    def share(self) -> float:
        """Of trials that completed."""
        return sum(done for done, _ in self.completed.values()) / max(1, self.trials)


@dataclass(frozen=True, kw_only=True)
class Cliff:
    """Where a policy breaks off.

    Attributes:
        holds: the last value, from the reference outwards, at which it does not.
        falls: the first at which it does.
        p: of Fisher's exact test against the reference, before Bonferroni.
    """

    holds: Point
    falls: Point
    p: float


@dataclass(frozen=True, kw_only=True)
class AxisCurve:
    """A policy along an axis.

    Attributes:
        axis: its name.
        policy: the policy's label.
        points: by value, ascending.
        reference: nearest to what changes nothing.
        cliffs: below the reference and above it, as far as there are any.
        confidence: of the intervals, and of all comparisons with the reference together.
    """

    axis: str
    policy: str
    points: tuple[Point, ...]
    reference: Point
    cliffs: tuple[Cliff, ...]
    confidence: float


def curve_of(axis: str, policy: str, rows: Sequence[Row], confidence: float = 0.95) -> AxisCurve:
    """Return the curve of a policy's trials, each of which lies in a cell of one axis.

    Raises:
        ValueError: there are no rows.
    """
    values = sorted({dict(row.perturbation)[axis] for row in rows})
    points = tuple(
        _point(value, [row for row in rows if dict(row.perturbation)[axis] == value], confidence)
        for value in values
    )
    neutral = NEUTRAL[axis]
    middle = _BUILT_FRICTION if neutral is None else neutral
    place = min(range(len(points)), key=lambda i: (abs(points[i].value - middle), i))
    sides = (points[:place][::-1], points[place + 1 :])
    most = (1.0 - confidence) / max(1, len(points) - 1)
    cliffs = [_cliff(points[place], side, most) for side in sides]
    return AxisCurve(
        axis=axis,
        policy=policy,
        points=points,
        reference=points[place],
        cliffs=tuple(cliff for cliff in cliffs if cliff is not None),
        confidence=confidence,
    )


def chance(one: Point, other: Point) -> float:
    """Return the probability that completion is as unequal by chance: Fisher's exact test."""
    scenes = sorted(set(one.completed) & set(other.completed))
    return fisher(*((one.completed[scene], other.completed[scene]) for scene in scenes))


def _cliff(reference: Point, outwards: Sequence[Point], most: float) -> Cliff | None:
    holds = reference
    for point in outwards:
        p = chance(reference, point)
        if p <= most and point.share < reference.share:
            return Cliff(holds=holds, falls=point, p=p)
        holds = point
    return None


def _point(value: float, rows: Sequence[Row], confidence: float) -> Point:
    scenes: dict[str, list[Row]] = {}
    for row in rows:
        if row.success is not None:
            scenes.setdefault(row.scene, []).append(row)
    found = [[row.success for row in group] for _, group in sorted(scenes.items())]
    if found:
        estimate = mean_of_scenes([np.array(group) for group in found], confidence)
        mean, interval = estimate.mean, estimate.interval
    else:
        mean, interval = None, Interval(0.0, 1.0)
    return Point(
        value=value,
        mean=mean,
        interval=interval,
        completed={
            scene: (sum(bool(row.completed) for row in group), len(group))
            for scene, group in sorted(scenes.items())
        },
        errors=sum(row.success is None for row in rows),
    )
