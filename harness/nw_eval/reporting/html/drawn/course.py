"""Where on the course it fails: who came how far, and who missed which waypoint."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nw_eval.gate.verdict import SceneDrop, Verdict
from nw_eval.results.row import Row
from nw_eval.stats.hazard import Ends, Hazard, differences_over, hazards
from nw_eval.stats.interval import Interval, wilson

_LEVELS = (0.0, 0.1, 0.25, 0.5, 0.75)
"""Shares of trials over which a cell is drawn one step stronger."""


@dataclass(frozen=True, kw_only=True)
class Missed:
    """A waypoint in one scene."""

    candidate: Hazard
    baseline: Hazard | None = None
    parted: bool = False
    """Whether the candidate parts from the baseline here, beyond doubt."""

    @property
    def level(self) -> int:
        """How strongly to draw it, from 0, nobody missed it, to 5."""
        return sum((self.candidate.share or 0.0) > least for least in _LEVELS)


@dataclass(frozen=True, kw_only=True)
class SceneCourse:
    """A scene, waypoint by waypoint."""

    scene: str
    name: str
    """With what was changed there."""
    waypoints: tuple[Missed, ...]


@dataclass(frozen=True, kw_only=True)
class Waypoint:
    """The first, second, .. waypoint of all scenes that have so many."""

    candidate: Hazard
    survived: float
    """Share, of all trials that started there, that reached it."""
    baseline: Hazard | None = None
    baseline_survived: float | None = None
    difference: Interval | None = None
    """Of the shares that missed it: the candidate's less the baseline's, this waypoint alone."""


@dataclass(frozen=True, kw_only=True)
class FailingCourse:
    """All scenes, the one that lost most first, and all of them together."""

    scenes: tuple[SceneCourse, ...]
    together: tuple[Waypoint, ...]
    baseline: str = ""
    """What the baseline is, in words; empty without one."""

    @property
    def order(self) -> tuple[str, ...]:
        """Scenes in that order."""
        return tuple(dict.fromkeys(each.scene for each in self.scenes))

    @property
    def compared(self) -> bool:
        """Whether there is a baseline beside it."""
        return any(each.baseline is not None for each in self.together)


def course(rows: Sequence[Row], verdict: Verdict) -> FailingCourse:
    """Return where trials ended.

    Against a baseline it is what the gate compared, the trials judged beside all starts of the
    bank; else it is all trials that came to a result.
    """
    against = () if verdict.against is None else verdict.against.scenes
    judged = [item for item in against if item.ends is not None and sum(item.ends[1])]
    if judged:
        scenes = [_compared(item, *item.ends) for item in judged if item.ends is not None]
        together = _together_compared([item.ends for item in judged if item.ends is not None])
    else:
        ends = _ends(rows)
        scenes = [
            SceneCourse(
                scene=scene,
                name=scene,
                waypoints=tuple(Missed(candidate=each) for each in hazards(found)),
            )
            for scene, found in ends.items()
        ]
        together = _together(list(ends.values()))
    scenes.sort(key=lambda scene: (-_lost(scene), scene.name))
    return FailingCourse(
        scenes=tuple(scenes), together=together, baseline=_baseline(verdict) if judged else ""
    )


def _baseline(verdict: Verdict) -> str:
    """Return which trials of the baseline the candidate's stand beside."""
    if verdict.against is not None and verdict.against.basis == "control":
        return "those of its policy that ran beside the candidate"
    return "all starts of the baseline"


def survived(ends: Sequence[Ends], waypoint: int) -> float:
    """Return which share, of the trials in scenes with so many waypoints, reached one."""
    here = [each for each in ends if len(each) > waypoint]
    return sum(sum(each[waypoint:]) for each in here) / max(1, sum(map(sum, here)))


def _ends(rows: Sequence[Row]) -> dict[str, Ends]:
    found: dict[str, Ends] = {}
    results: defaultdict[str, list[Row]] = defaultdict(list)
    for row in rows:
        if row.status == "ok":
            results[row.scene].append(row)
    for scene, here in sorted(results.items()):
        total = max((row.waypoints_total for row in here), default=0)
        if total:
            reached = np.bincount([row.waypoints_reached for row in here], minlength=total + 1)
            found[scene] = [int(count) for count in reached]
    return found


def _compared(item: SceneDrop, baseline: Ends, candidate: Ends) -> SceneCourse:
    pairs = zip(hazards(baseline), hazards(candidate), strict=True)
    return SceneCourse(
        scene=item.scene,
        name=item.name,
        waypoints=tuple(
            Missed(candidate=two, baseline=one, parted=two.waypoint == item.waypoint)
            for one, two in pairs
        ),
    )


def _together_compared(pairs: Sequence[tuple[Ends, Ends]]) -> tuple[Waypoint, ...]:
    one, two = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
    return tuple(
        Waypoint(
            candidate=each.second,
            survived=survived(two, each.waypoint),
            baseline=each.first,
            baseline_survived=survived(one, each.waypoint),
            difference=each.interval if each.second.trials else None,
        )
        for each in differences_over(pairs)
    )


def _together(ends: Sequence[Ends]) -> tuple[Waypoint, ...]:
    found: list[Waypoint] = []
    for k in range(1, max(map(len, ends), default=1)):
        here = [each for each in ends if len(each) > k]
        failed, trials = sum(each[k - 1] for each in here), sum(sum(each[k - 1 :]) for each in here)
        hazard = Hazard(
            waypoint=k, trials=trials, failed=failed, interval=wilson(failed, trials, 0.95)
        )
        found.append(Waypoint(candidate=hazard, survived=survived(ends, k)))
    return tuple(found)


def _lost(scene: SceneCourse) -> float:
    """Return which share of a scene's trials did not reach its last waypoint."""
    first, last = scene.waypoints[0].candidate, scene.waypoints[-1].candidate
    return 1.0 - (last.trials - last.failed) / max(1, first.trials)
