"""Success of one policy along one axis, and the values at which it breaks off.

The cliff is not the steepest piece of a noisy line. The value nearest to the neutral one is the
reference; going outwards from it on each side, the cliff is the first value at which fewer trials
complete than there beyond chance: Fisher's exact test with scenes as strata, Bonferroni over all
values that are compared. What chance may explain is no cliff, and is said to be none. Where not
even a fall to no completed trial would be beyond chance, there are too few trials to tell.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from types import MappingProxyType
from typing import Protocol

import numpy as np

from nw_gate.results.row import Row
from nw_gate.scores import ScoreSpec
from nw_gate.stats.bootstrap import mean_of_scenes
from nw_gate.stats.interval import Interval, fisher


class AxisLike(Protocol):
    """What a curve must know of its axis."""

    @property
    def name(self) -> str: ...  # noqa: D102
    @property
    def reference(self) -> float: ...  # noqa: D102


@dataclass(frozen=True, kw_only=True)
class Point:
    """One value of an axis.

    Attributes:
        value: of the axis.
        mean: success over scenes, 0..1; None without a result.
        interval: of the mean, alone.
        completed: trials that reached all waypoints, and all trials with a result, by scene.
        errors: trials without a result.
        scores: means of what was measured beside success, by name, scenes weighted equally.
    """

    value: float
    mean: float | None
    interval: Interval
    completed: dict[str, tuple[int, int]]
    errors: int
    scores: Mapping[str, float] = field(default_factory=dict[str, float])

    @property
    def trials(self) -> int:
        """How many have a result."""
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
        needed: trials of each value in each scene that could show a fall from the reference's
            share to none, at least; None if every value that is compared has enough.
    """

    axis: str
    policy: str
    points: tuple[Point, ...]
    reference: Point
    cliffs: tuple[Cliff, ...]
    confidence: float
    needed: int | None = None

    def could_fall(self, point: Point) -> bool:
        """Return whether so many trials as a value has could show a fall to none at all."""
        return _shows_none(self.reference, point, _most(self.confidence, len(self.points) - 1))


def curve_of(
    axis: AxisLike,
    policy: str,
    rows: Sequence[Row],
    confidence: float = 0.95,
    specs: Mapping[str, ScoreSpec] = MappingProxyType({}),
) -> AxisCurve:
    """Return the curve of a policy's trials, each of which lies in a cell of one axis.

    Args:
        axis: along which they were run.
        policy: what it is called.
        rows: of its trials.
        confidence: of each interval, and of all cliffs together.
        specs: what was measured beside success, by name.

    Raises:
        ValueError: there are no rows.
    """
    values = sorted({dict(row.perturbation)[axis.name] for row in rows})
    points = tuple(
        _point(
            value,
            [row for row in rows if dict(row.perturbation)[axis.name] == value],
            confidence,
            specs,
        )
        for value in values
    )
    place = min(range(len(points)), key=lambda i: (abs(points[i].value - axis.reference), i))
    sides = (points[:place][::-1], points[place + 1 :])
    most = _most(confidence, len(points) - 1)
    cliffs = [_cliff(points[place], side, most) for side in sides]
    enough = all(_shows_none(points[place], point, most) for side in sides for point in side)
    return AxisCurve(
        axis=axis.name,
        policy=policy,
        points=points,
        reference=points[place],
        cliffs=tuple(cliff for cliff in cliffs if cliff is not None),
        confidence=confidence,
        needed=None if enough else _least(points[place].completed, most),
    )


def needed_to_part(one: AxisCurve, other: AxisCurve) -> int | None:
    """Return how many trials of each value in each scene could show that two policies part.

    That is the least with which all trials of one and none of the other that complete are beyond
    chance. None if there is a value at which both have that many.
    """
    theirs = {point.value: point for point in other.points}
    both = [(point, theirs[point.value]) for point in one.points if point.value in theirs]
    most = _most(one.confidence, len(both))
    for mine, yours in both:
        all_of_them = {scene: (n, n) for scene, (_, n) in mine.completed.items()}
        if _shows_none(replace(mine, completed=all_of_them), yours, most):
            return None
    scenes = {scene for mine, _ in both for scene in mine.completed}
    return _least(dict.fromkeys(scenes, (1, 1)), most)


def _most(confidence: float, comparisons: int) -> float:
    """Return the largest p-value of one of several comparisons that counts: Bonferroni."""
    return (1.0 - confidence) / max(1, comparisons)


def _shows_none(reference: Point, point: Point, most: float) -> bool:
    """Return whether no completed trial at a value would be beyond chance."""
    none = {scene: (0, n) for scene, (_, n) in point.completed.items()}
    return chance(reference, replace(point, completed=none)) <= most


def _least(completed: Mapping[str, tuple[int, int]], most: float) -> int | None:
    """Return the least trials in each scene that show a fall from these shares to none.

    None where nothing completed, so that there is nothing to fall from.
    """
    shares = [Fraction(done, n) for done, n in completed.values() if n]
    if not any(shares):
        return None

    def shows(n: int) -> bool:
        return fisher(*(((int(share * n), n), (0, n)) for share in shares)) <= most

    enough = 1
    while not shows(enough):
        enough *= 2
    return bisect_left(range(enough), True, key=shows) if enough > 1 else 1


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


def _counted(row: Row, spec: ScoreSpec) -> float:
    failed = row.outcome == "policy_failed"
    return spec.counted(None if failed else dict(row.scores).get(spec.name))


def _point(
    value: float, rows: Sequence[Row], confidence: float, specs: Mapping[str, ScoreSpec]
) -> Point:
    scenes: dict[str, list[Row]] = {}
    for row in rows:
        if row.success is not None:
            scenes.setdefault(row.scene, []).append(row)
    successes = [[row.success for row in group] for _, group in sorted(scenes.items())]
    if successes:
        estimate = mean_of_scenes([np.array(group) for group in successes], confidence)
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
        scores={
            name: float(
                np.mean(
                    [np.mean([_counted(row, spec) for row in group]) for group in scenes.values()]
                )
            )
            for name, spec in specs.items()
            if scenes
        },
    )
