"""Where on its course a policy fails, and the first waypoint at which two policies part.

A trial reaches the waypoints of its course in order. The hazard of waypoint k is the share of the
trials that reached k - 1 and then did not reach k. Success is made of hazards, and a hazard, other
than the share of all trials that reached k, does not carry on what went wrong before k.

Two policies are compared at every waypoint by Fisher's exact test among the trials of each that
came so far. Its p-value holds for every number of them, so it holds although that number is chance.
Several waypoints are looked at, of one scene or of many; Holm's procedure keeps the probability
that any waypoint is named at which the hazards are equal to at most `error`, whatever the
dependence between them. The first parting is the first waypoint so named: that they part there is
significantly, that they did not part before is not.

Trials count as independent, also those of the two policies from one start. Where these go alike,
the tests err less often than they may.

Source: J. D. Singer and J. B. Willett, "It's about time: using discrete-time survival analysis",
J. Educ. Statist. 18 (1993) for the hazard; S. Holm, "A simple sequentially rejective multiple test
procedure", Scand. J. Statist. 6 (1979).
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from nw_gate.stats.interval import Interval, check_confidence, fisher, newcombe, wilson

Ends = Sequence[int]
"""How many trials of a scene ended after 0, 1, .. K waypoints: K + 1 numbers."""
Place = TypeVar("Place", bound=Hashable)


@dataclass(frozen=True, kw_only=True)
class Hazard:
    """How often the next waypoint was missed."""

    waypoint: int
    """From 1."""
    trials: int
    """That reached the waypoint before, or started, if this is the first."""
    failed: int
    """Of these, that did not reach this one."""
    interval: Interval
    """Of the share: Wilson's; [0, 1] where no trial got so far."""

    @property
    def share(self) -> float | None:
        """The hazard; None where no trial got so far."""
        return self.failed / self.trials if self.trials else None


@dataclass(frozen=True, kw_only=True)
class HazardDifference:
    """Two policies at one waypoint."""

    first: Hazard
    second: Hazard
    interval: Interval
    """Of the second's hazard less the first's, this waypoint alone: Newcombe's hybrid score."""
    p: float
    """Fisher's, two-sided, this waypoint alone."""

    @property
    def waypoint(self) -> int:
        """From 1."""
        return self.first.waypoint


@dataclass(frozen=True, kw_only=True)
class Parting(HazardDifference):
    """The first waypoint at which two policies part significantly."""

    adjusted_p: float
    """Holm's, over all waypoints that were looked at: it is shown at any `error` from this on."""
    compared: int
    """How many waypoints those were."""


def hazards(ends: Ends, confidence: float = 0.95) -> tuple[Hazard, ...]:
    """Return the hazard of every waypoint, 1 to K, each with its own interval.

    Raises:
        ValueError: there are no waypoints, a count is negative, or the confidence is none.
    """
    check_confidence(confidence)
    if len(ends) < 2 or any(count < 0 for count in ends):
        raise ValueError(f"{list(ends)} are not numbers of trials that ended after 0, 1, .. K")
    return tuple(
        _hazard(k, ends[k - 1], sum(ends[k - 1 :]), confidence) for k in range(1, len(ends))
    )


def differences(
    first: Ends, second: Ends, confidence: float = 0.95
) -> tuple[HazardDifference, ...]:
    """Return how two policies differ at every waypoint of one scene, each looked at alone.

    Raises:
        ValueError: as `hazards`; or they are not of one scene: the numbers of waypoints differ.
    """
    if len(first) != len(second):
        raise ValueError(f"{len(first) - 1} waypoints cannot be compared with {len(second) - 1}")
    return tuple(
        HazardDifference(
            first=one,
            second=two,
            interval=newcombe((one.failed, one.trials), (two.failed, two.trials), confidence),
            p=fisher(((one.failed, one.trials), (two.failed, two.trials))),
        )
        for one, two in zip(hazards(first, confidence), hazards(second, confidence), strict=True)
    )


def differences_over(
    scenes: Sequence[tuple[Ends, Ends]], confidence: float = 0.95
) -> tuple[HazardDifference, ...]:
    """Return how two policies differ at the first, second, .. waypoint of all scenes together.

    Numbers of trials, and the intervals, are of all scenes that have so many waypoints as if they
    were one; p compares only within scenes, so that no scene's difficulty is taken for a policy's.

    Args:
        scenes: ends of both policies in each scene, at least one.
        confidence: of each interval.

    Raises:
        ValueError: as `differences`.
    """
    looked_at = [differences(*pair, confidence) for pair in scenes]
    hazard_differences: list[HazardDifference] = []
    for k in range(max(map(len, looked_at))):
        counts = [scene[k] for scene in looked_at if k < len(scene)]
        one, two = (
            (sum(side.failed for side in sides), sum(side.trials for side in sides))
            for sides in ([each.first for each in counts], [each.second for each in counts])
        )
        hazard_differences.append(
            HazardDifference(
                first=_hazard(k + 1, *one, confidence),
                second=_hazard(k + 1, *two, confidence),
                interval=newcombe(one, two, confidence),
                p=fisher(
                    *(
                        ((a.failed, a.trials), (b.failed, b.trials))
                        for a, b in ((each.first, each.second) for each in counts)
                    )
                ),
            )
        )
    return tuple(hazard_differences)


def first_partings(
    pairs: Mapping[Place, tuple[Ends, Ends]], error: float = 0.05
) -> dict[Place, Parting]:
    """Return the first parting in every scene that has one, all looked at together.

    Args:
        pairs: ends of two policies' trials, by scene, or by whatever else.
        error: at most this is the probability of naming any waypoint of equal hazards anywhere.

    Raises:
        ValueError: as `differences`.
    """
    return first_shown(
        {place: differences(*pair, 1.0 - error) for place, pair in pairs.items()}, error
    )


def first_shown(
    looked_at: Mapping[Place, Sequence[HazardDifference]], error: float = 0.05
) -> dict[Place, Parting]:
    """Return the first waypoint that is shown in each scene, all that were looked at together.

    Args:
        looked_at: every waypoint that could be named, in order, by scene.
        error: as in `first_partings`.
    """
    adjusted = holm([each.p for waypoints in looked_at.values() for each in waypoints])
    ps = iter(adjusted)
    partings: dict[Place, Parting] = {}
    for place, waypoints in looked_at.items():
        shown = [(each, p) for each in waypoints if (p := next(ps)) <= error]
        if shown:
            each, p = shown[0]
            partings[place] = Parting(**vars(each), adjusted_p=p, compared=len(adjusted))
    return partings


def _hazard(waypoint: int, failed: int, trials: int, confidence: float) -> Hazard:
    interval = wilson(failed, trials, confidence)
    return Hazard(waypoint=waypoint, trials=trials, failed=failed, interval=interval)


def holm(ps: Sequence[float]) -> tuple[float, ...]:
    """Return p-values adjusted for how many there are: those up to `a` err together at most at `a`.

    Source: Holm (1979), as above; no assumption on how the tests depend on each other.
    """
    largest = 0.0
    adjusted = [0.0] * len(ps)
    for rank, index in enumerate(sorted(range(len(ps)), key=lambda index: ps[index])):
        largest = max(largest, min(1.0, (len(ps) - rank) * ps[index]))
        adjusted[index] = largest
    return tuple(adjusted)
