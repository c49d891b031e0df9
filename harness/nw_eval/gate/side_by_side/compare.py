"""Several policies, each on as many starts of each scene: on the same ones, if they share them.

On these starts success is known. What is left to chance, and what intervals and ranks speak of, is
fresh starts in the same scenes. Every scene counts alike, whatever its tier.

Runs that each drew trials of their own from a bank share few starts. They are compared on starts of
their own, the first of each with the first of the others: which ones they drew follows from hashes,
so that the differences are as independent as those of fresh starts.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import groupby, islice

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import IncomparableError, UsageError
from nw_eval.gate.side_by_side.entrant import Entrant, StartName, check_alike
from nw_eval.gate.side_by_side.result import (
    ComparedPolicy,
    ComparedScene,
    ComparedTask,
    PolicyComparison,
    SceneParting,
)
from nw_eval.stats import mean_of_scenes
from nw_eval.stats.hazard import (
    Ends,
    HazardDifference,
    differences,
    differences_over,
    first_shown,
)
from nw_eval.stats.ranks import Ranks, possible_ranks

_Starts = Mapping[str, list[StartName]]
"""Starts by scene, in alphabetical order."""


def side_by_side(entrants: Sequence[Entrant], confidence: float = 0.95) -> PolicyComparison:
    """Return what policies show side by side.

    Args:
        entrants: at least two; where they part is where each parts from the first.
        confidence: of each interval alone; of all ranks together; of all partings together.

    Raises:
        UsageError: there are fewer than two.
        IncomparableError: they differ in suite, scenes, starts or simulator; or one has no result
            from a scene.
    """
    if len(entrants) < 2:
        raise UsageError("one policy has nothing to compare with", fix="name two runs or more")
    return compared(entrants, confidence)


def compared(entrants: Sequence[Entrant], confidence: float = 0.95) -> PolicyComparison:
    """Return as `side_by_side` what one policy or more show; of one there is no other rank than 1.

    Raises:
        IncomparableError: as `side_by_side`.
    """
    check_alike(entrants)
    shared = _shared(entrants)
    met = [shared] * len(entrants) if shared else _own(entrants)
    groups = [
        [_successes(entrant, names) for names in scenes.values()]
        for entrant, scenes in zip(entrants, met, strict=True)
    ]
    ranks = possible_ranks(groups, 1.0 - confidence)
    partings, waypoints = _partings(entrants, met, confidence)
    return PolicyComparison(
        suite=entrants[0].suite,
        confidence=confidence,
        policies=tuple(
            _policy(entrant, label, values, ranks[index], confidence)
            for index, (entrant, label, values) in enumerate(
                zip(entrants, _labels(entrants), groups, strict=True)
            )
        ),
        scenes=tuple(
            ComparedScene(
                scene=scene,
                starts=len(names),
                means=tuple(float(values[index].mean()) for values in groups),
            )
            for index, (scene, names) in enumerate(met[0].items())
        ),
        tasks=_tasks(entrants[0], met[0], groups, confidence),
        shared=bool(shared),
        partings=partings,
        waypoints=waypoints,
        left_out=len({name for each in entrants for name in each.results})
        - len({name for scenes in met for names in scenes.values() for name in names}),
    )


def _shared(entrants: Sequence[Entrant]) -> _Starts:
    """Return the starts that all have a result from, in order; none if these are too few.

    Too few is less than half of what the one with the fewest has, or none in a scene.
    """
    fewest = min(len(each.results) for each in entrants)
    names = set(entrants[0].results).intersection(*(each.results for each in entrants[1:]))
    scenes = {
        scene: [name for name in sorted(names) if name[0] == scene] for scene in _scenes(entrants)
    }
    return scenes if all(scenes.values()) and 2 * len(names) >= fewest else {}


def _own(entrants: Sequence[Entrant]) -> list[_Starts]:
    """Return starts of each policy's own: in each scene, and cell of what is changed, as many."""
    results = [sorted(each.results) for each in entrants]
    counts = [Counter(name[:2] for name in names) for names in results]
    strata = sorted(set().union(*counts))
    most = {stratum: min(count[stratum] for count in counts) for stratum in strata}
    for scene in _scenes(entrants):
        for entrant, count in zip(entrants, counts, strict=True):
            if not any(count[stratum] for stratum in strata if stratum[0] == scene):
                raise IncomparableError(
                    f"{entrant.source} has no result from scene {scene}",
                    fix="--resume it, or run it again",
                )
    found: list[_Starts] = []
    for names in results:
        scenes: dict[str, list[StartName]] = {scene: [] for scene in _scenes(entrants)}
        for stratum, group in groupby(names, key=lambda name: name[:2]):
            scenes[stratum[0]] += islice(group, most[stratum])
        found.append(scenes)
    return found


def _scenes(entrants: Sequence[Entrant]) -> list[str]:
    return sorted(entrants[0].key.scenes)


def _successes(entrant: Entrant, names: Sequence[StartName]) -> NDArray[np.float64]:
    # Neither a bank nor a trial that came to a result is without one.
    return np.array([entrant.results[name].success for name in names], dtype=np.float64)


def _policy(
    entrant: Entrant,
    label: str,
    groups: Sequence[NDArray[np.float64]],
    ranks: Ranks,
    confidence: float,
) -> ComparedPolicy:
    estimate = mean_of_scenes(groups, confidence)
    return ComparedPolicy(
        label=label,
        policy=entrant.policy,
        source=entrant.source,
        mean=estimate.mean,
        interval=estimate.interval,
        completed=sum(int((group == 1.0).sum()) for group in groups),
        ranks=ranks,
    )


def _tasks(
    entrant: Entrant,
    starts: _Starts,
    groups: Sequence[Sequence[NDArray[np.float64]]],
    confidence: float,
) -> tuple[ComparedTask, ...]:
    """Return success by task; a scene's is that of any of its trials."""
    places: dict[str, list[int]] = {}
    for place, names in enumerate(starts.values()):
        places.setdefault(entrant.results[names[0]].task, []).append(place)
    return tuple(
        ComparedTask(
            task=task,
            scenes=len(which),
            estimates=tuple(
                mean_of_scenes([values[place] for place in which], confidence) for values in groups
            ),
        )
        for task, which in sorted(places.items())
    )


def _labels(entrants: Sequence[Entrant]) -> list[str]:
    """Return a name for each policy that no other one has."""
    policies = Counter(each.policy for each in entrants)
    labels = [
        each.policy if policies[each.policy] == 1 else f"{each.policy} ({_short(each.source)})"
        for each in entrants
    ]
    clashing = Counter(labels)
    return [
        label if clashing[label] == 1 else f"{label} #{place}"
        for place, label in enumerate(labels, 1)
    ]


def _short(source: str) -> str:
    return source.rstrip("/").rpartition("/")[2]


def _partings(
    entrants: Sequence[Entrant], starts: Sequence[_Starts], confidence: float
) -> tuple[tuple[SceneParting, ...], int]:
    """Return where each policy parts from the first, and how many waypoints were looked at."""
    first, *others = [
        {scene: _ends(entrant, names) for scene, names in scenes.items()}
        for entrant, scenes in zip(entrants, starts, strict=True)
    ]
    together: dict[tuple[int, str | None], tuple[HazardDifference, ...]] = {}
    alone: dict[tuple[int, str | None], tuple[HazardDifference, ...]] = {}
    for place, scenes in enumerate(others, 1):
        # A trail without waypoints has none to part at.
        pairs = {scene: (first[scene], ends) for scene, ends in scenes.items() if len(ends) > 1}
        if len(pairs) > 1:
            together[place, None] = differences_over(list(pairs.values()), confidence)
        for scene, pair in pairs.items():
            alone[place, scene] = differences(*pair, confidence)
    # The few waypoints of all scenes together are not to pay for the many of single ones.
    error = (1.0 - confidence) / (2 if together else 1)
    shown = {**first_shown(together, error), **first_shown(alone, error)}
    found: list[SceneParting] = []
    for where, waypoints in (together | alone).items():
        suspect = next((each for each in waypoints if each.p <= 1.0 - confidence), None)
        if at := shown.get(where, suspect):
            place, scene = where
            found.append(SceneParting(scene=scene, policy=place, at=at, shown=where in shown))
    found.sort(key=lambda each: (not each.shown, each.policy, each.scene or ""))
    return tuple(found), sum(map(len, (together | alone).values()))


def _ends(entrant: Entrant, names: Sequence[StartName]) -> Ends:
    results = [entrant.results[name] for name in names]
    most = max(each.waypoints_total for each in results)
    reached = np.array([each.waypoints_reached for each in results], dtype=np.int64)
    return [int(count) for count in np.bincount(reached, minlength=most + 1)]
