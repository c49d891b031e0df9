"""Several policies side by side, each on as many starts of each scene: on the same, if shared.

On these starts success is known. What is left to chance, and what intervals and ranks speak of, is
fresh starts in the same scenes. Every scene counts alike, whatever its tier.

Runs that each drew trials of their own from a baseline share few starts. They are compared on
starts of their own, the first of each with the first of the others: which ones they drew follows
from hashes, so that the differences are as independent as those of fresh starts.

Results on the robot are put beside those of the same policies in the simulator (`measured`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby, islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import IncomparableError, UsageError, nearest
from nw_gate.limits.limit import Limit
from nw_gate.results.baseline import BaselineKey, BaselineResults, Panel, Start, key_of
from nw_gate.results.column import Settings
from nw_gate.results.provenance import RunInfo
from nw_gate.results.real import RealResult
from nw_gate.results.row import Row, task_shown
from nw_gate.scores import BUILT_IN, ScoreSpec
from nw_gate.stats.agreement import Measured
from nw_gate.stats.bootstrap import mean_of_scenes
from nw_gate.stats.hazard import (
    Ends,
    HazardDifference,
    differences,
    differences_over,
    first_shown,
)
from nw_gate.stats.interval import Estimate, Interval
from nw_gate.stats.ranks import Ranks, possible_ranks

StartName = tuple[str, Settings, int]
"""Scene, what was changed there, and the start's number: the same for every policy of a suite."""


@dataclass(frozen=True, kw_only=True)
class Entrant:
    """A policy with its results, of a run or of a baseline."""

    source: str
    """The run or baseline as it was named."""
    suite: str
    policy: str
    key: BaselineKey
    results: Mapping[StartName, Row | Start]
    """Of the trials that came to one."""
    scores: Mapping[str, ScoreSpec] = field(default_factory=dict[str, ScoreSpec])
    """What was measured beside success, by name."""
    limits: Mapping[str, Limit] = field(default_factory=dict[str, Limit])
    """On the ladders of the suite's gate, by name."""


def entrant_of_run(
    source: str, run: RunInfo, rows: Iterable[Row], limits: Mapping[str, Limit] | None = None
) -> Entrant:
    """Return what a run compares with; its limits are those of the ladders that it climbed."""
    return Entrant(
        source=source,
        suite=str(run.suite.get("name", "")),
        policy=run.policy.folder_name,
        key=key_of(run),
        results=_named(row for row in rows if row.status == "ok"),
        scores=run.scores,
        limits=limits or {},
    )


def entrant_of_baseline(source: str, baseline: BaselineResults, panel: Panel) -> Entrant:
    """Return what a baseline compares with, on one class of machine."""
    return Entrant(
        source=source,
        suite=baseline.manifest.suite,
        policy=baseline.manifest.policy.name,
        key=baseline.manifest.key,
        results=_named(panel.starts),
        scores={
            name: cls.spec for name, cls in BUILT_IN.items() if name in baseline.manifest.scores
        },
        limits={
            name: Limit.from_dict(saved.limit) for name, saved in baseline.manifest.limits.items()
        },
    )


def check_alike(entrants: Sequence[Entrant]) -> None:
    """Refuse policies that did not meet the same task.

    Raises:
        IncomparableError: naming every field in which one differs from the first.
    """
    first = entrants[0]
    for other in entrants[1:]:
        if faults := list(_faults(first, other)):
            raise IncomparableError(
                f"{other.source} does not compare with {first.source}: {'; '.join(faults)}",
                fix="run both with one suite, one version of nw-eval and the same scenes",
            )


def _named(results: Iterable[Row | Start]) -> dict[StartName, Row | Start]:
    return {(each.scene, each.perturbation, each.seed_index): each for each in results}


def _faults(first: Entrant, other: Entrant) -> Iterable[str]:
    ours, theirs = other.key, first.key
    for name in ("seed", "protocol"):
        if getattr(ours, name) != getattr(theirs, name):
            yield f"its {name} is {getattr(ours, name)}, there {getattr(theirs, name)}"
    alike = ours.seed == theirs.seed and ours.protocol == theirs.protocol
    if alike and ours.suite_digest != theirs.suite_digest:
        digests = f"{ours.suite_digest[:8]}, there {theirs.suite_digest[:8]}"
        yield f"its suite digest (robot, task, episode, perturb, pictures, plug-ins) is {digests}"
    if lacking := sorted({*theirs.scenes} - {*ours.scenes}):
        yield f"it has no scene {_first(lacking)}"
    if foreign := sorted({*ours.scenes} - {*theirs.scenes}):
        yield f"only it has scene {_first(foreign)}"
    both = sorted({*ours.scenes} & {*theirs.scenes})
    if changed := [name for name in both if ours.scenes[name] != theirs.scenes[name]]:
        digests = f"{ours.scenes[changed[0]][:8]}, there {theirs.scenes[changed[0]][:8]}"
        yield f"the digest of its scene {_first(changed)} is {digests}"
    for name in sorted({*ours.simulator, *theirs.simulator}):
        mine, others = (key.simulator.get(name, "none") for key in (ours, theirs))
        if mine != others:
            yield f"its {name} is {mine}, there {others}"


def _first(names: Sequence[str]) -> str:
    return names[0] + (f" (and {len(names) - 1} more)" if len(names) > 1 else "")


@dataclass(frozen=True, kw_only=True)
class ComparedPolicy:
    """One policy over all scenes, these weighted equally."""

    label: str
    """What it is called here: the policy's name, and more where two have one name."""
    policy: str
    source: str
    """The run or baseline as it was named."""
    mean: float
    """Mean success over its starts."""
    interval: Interval
    """Of mean success for fresh starts, this policy alone: `mean_of_scenes`."""
    completed: int
    """Trials, of those starts, that reached their last waypoint."""
    ranks: Ranks
    """That fresh starts may give it; those of all policies hold together."""


@dataclass(frozen=True, kw_only=True)
class ComparedScene:
    """One scene, over all that was changed in it."""

    scene: str
    starts: int
    """Of each policy."""
    means: tuple[float, ...]
    """Mean success, in the order of the policies."""


@dataclass(frozen=True, kw_only=True)
class ComparedTask:
    """The scenes of one task, these weighted equally."""

    task: str
    scenes: int
    estimates: tuple[Estimate, ...]
    """Success of each policy, as `ComparedPolicy.mean` and `interval`."""


@dataclass(frozen=True, kw_only=True)
class ComparedScore:
    """A score that all policies were measured by, over all scenes, these weighted equally."""

    spec: ScoreSpec
    estimates: tuple[Estimate, ...]
    """Of each policy in the score's unit, as `ComparedPolicy.mean` and `interval`."""


@dataclass(frozen=True, kw_only=True)
class SceneParting:
    """The first waypoint at which a policy diverges from the first one."""

    scene: str | None
    """None: all scenes together."""
    policy: int
    """Place of the other policy in the order of the policies."""
    at: HazardDifference
    """`first` is the first policy's hazard."""
    shown: bool
    """Whether it holds with all other waypoints that were looked at. Otherwise it is suspect: this
    waypoint's p alone, of many, is at most 1 - confidence."""


@dataclass(frozen=True, kw_only=True)
class PolicyComparison:
    """Policies side by side, in the order in which they were named."""

    suite: str
    confidence: float
    policies: tuple[ComparedPolicy, ...]
    scenes: tuple[ComparedScene, ...]
    """In alphabetical order."""
    tasks: tuple[ComparedTask, ...]
    """In alphabetical order."""
    partings: tuple[SceneParting, ...]
    """By policy and scene, all scenes together before each; those shown first."""
    waypoints: int
    """That were looked at for partings, over all scenes and policies."""
    shared: bool
    """Whether all have a result from the same starts; else each has as many starts of its own."""
    left_out: int
    """Starts that some policies have a result from, and that are not looked at."""
    scores: tuple[ComparedScore, ...] = ()
    """In the order of the first policy's."""
    unmet: tuple[str, ...] = ()
    """Scenes that are not compared: not all have a result from them."""
    limits: Mapping[str, tuple[Limit | None, ...]] = field(
        default_factory=dict[str, "tuple[Limit | None, ...]"]
    )
    """Of each policy on each ladder that any of them climbed; None where it did not."""

    @property
    def starts(self) -> int:
        """Of each policy: what every number here is over."""
        return sum(scene.starts for scene in self.scenes)


_Starts = Mapping[str, list[StartName]]
"""Starts by scene, in alphabetical order."""


def side_by_side(entrants: Sequence[Entrant], confidence: float = 0.95) -> PolicyComparison:
    """Return what policies show side by side.

    Args:
        entrants: at least two; where they diverge is where each diverges from the first.
        confidence: of each interval alone; of all ranks together; of all partings together.

    Raises:
        UsageError: there are fewer than two.
        IncomparableError: they differ in suite, scenes, starts or simulator; or one has no result
            from any scene that the others met.
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
    # A round of bets has one trial of each scene in each cell of what is changed.
    strata = [
        [_successes(entrant, list(names)) for _, names in _by_stratum(scenes)]
        for entrant, scenes in zip(entrants, met, strict=True)
    ]
    ranks = possible_ranks(strata, 1.0 - confidence)
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
        scores=_scores(entrants, met, confidence),
        shared=bool(shared),
        partings=partings,
        waypoints=waypoints,
        unmet=tuple(sorted({*entrants[0].key.scenes} - {*met[0]})),
        left_out=len({name for each in entrants for name in each.results})
        - len({name for scenes in met for names in scenes.values() for name in names}),
        limits={
            ladder: tuple(each.limits.get(ladder) for each in entrants)
            for ladder in sorted({name for each in entrants for name in each.limits})
        },
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
    own: list[_Starts] = []
    for names in results:
        scenes: dict[str, list[StartName]] = {scene: [] for scene in _scenes(entrants)}
        for stratum, group in groupby(names, key=lambda name: name[:2]):
            if stratum[0] in scenes:
                scenes[stratum[0]] += islice(group, most[stratum])
        own.append(scenes)
    return own


def _by_stratum(starts: _Starts) -> Iterator[tuple[object, Iterator[StartName]]]:
    """Return the starts of each scene and cell of what is changed."""
    return groupby((name for names in starts.values() for name in names), lambda name: name[:2])


def _scenes(entrants: Sequence[Entrant]) -> list[str]:
    """Return the scenes from which all have a result, in one cell of what is changed at least.

    A run that a baseline settled has met some scenes only, and more trials of it say no more.

    Raises:
        IncomparableError: there is none.
    """
    strata = set.intersection(*({name[:2] for name in each.results} for each in entrants))
    if not strata:
        raise IncomparableError(
            f"{' and '.join(each.source for each in entrants)} have results from no scene in "
            "common",
            fix="run them again with --all-rounds",
        )
    return sorted({scene for scene, _ in strata})


def _successes(entrant: Entrant, names: Sequence[StartName]) -> NDArray[np.float64]:
    # Neither a baseline nor a trial that have a result is without one.
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
        first = entrant.results[names[0]]
        places.setdefault(task_shown(first.scene, first.task), []).append(place)
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


def _scores(
    entrants: Sequence[Entrant], met: Sequence[_Starts], confidence: float
) -> tuple[ComparedScore, ...]:
    """Return the scores that all were measured by, and that all declare alike."""
    scores: list[ComparedScore] = []
    for name, spec in entrants[0].scores.items():
        if any(each.scores.get(name) != spec for each in entrants):
            continue
        estimates: list[Estimate] = []
        for entrant, scenes in zip(entrants, met, strict=True):
            groups = [
                np.array([_counted(entrant.results[start], spec) for start in names])
                for names in scenes.values()
            ]
            scaled = mean_of_scenes(groups, confidence)
            ends = sorted(map(spec.unscaled, scaled.interval))
            estimates.append(
                replace(scaled, mean=spec.unscaled(scaled.mean), interval=Interval(*ends))
            )
        scores.append(ComparedScore(spec=spec, estimates=tuple(estimates)))
    return tuple(scores)


def _labels(entrants: Sequence[Entrant]) -> list[str]:
    """Return a name for each policy that no other one has."""
    policies = Counter(each.policy for each in entrants)
    labels = [
        each.policy
        if policies[each.policy] == 1
        else f"{each.policy} ({each.source.rstrip('/').rpartition('/')[2]})"
        for each in entrants
    ]
    clashing = Counter(labels)
    return [
        label if clashing[label] == 1 else f"{label} #{index}"
        for index, label in enumerate(labels, 1)
    ]


def _partings(
    entrants: Sequence[Entrant], starts: Sequence[_Starts], confidence: float
) -> tuple[tuple[SceneParting, ...], int]:
    """Return where each policy diverges from the first, and how many waypoints were looked at."""
    first, *others = [
        {scene: _ends(entrant, names) for scene, names in scenes.items()}
        for entrant, scenes in zip(entrants, starts, strict=True)
    ]
    together: dict[tuple[int, str | None], tuple[HazardDifference, ...]] = {}
    alone: dict[tuple[int, str | None], tuple[HazardDifference, ...]] = {}
    for place, scenes in enumerate(others, 1):
        # A course without waypoints has none to part at.
        pairs = {scene: (first[scene], ends) for scene, ends in scenes.items() if len(ends) > 1}
        if len(pairs) > 1:
            together[place, None] = differences_over(list(pairs.values()), confidence)
        for scene, pair in pairs.items():
            alone[place, scene] = differences(*pair, confidence)
    # The few waypoints of all scenes together are not to pay for the many of single ones.
    error = (1.0 - confidence) / (2 if together else 1)
    shown = {**first_shown(together, error), **first_shown(alone, error)}
    partings: list[SceneParting] = []
    for where, waypoints in (together | alone).items():
        suspect = next((each for each in waypoints if each.p <= 1.0 - confidence), None)
        if at := shown.get(where, suspect):
            place, scene = where
            partings.append(SceneParting(scene=scene, policy=place, at=at, shown=where in shown))
    partings.sort(key=lambda each: (not each.shown, each.policy, each.scene or ""))
    return tuple(partings), sum(map(len, (together | alone).values()))


def _ends(entrant: Entrant, names: Sequence[StartName]) -> Ends:
    results = [entrant.results[name] for name in names]
    most = max(each.waypoints_total for each in results)
    reached = np.array([each.waypoints_reached for each in results], dtype=np.int64)
    return [int(count) for count in np.bincount(reached, minlength=most + 1)]


def score_of(name: str, entrants: Sequence[Entrant]) -> ScoreSpec:
    """Return the declaration of a score that all policies were measured by.

    Raises:
        UsageError: one was not; or two declare it otherwise.
    """
    for each in entrants:
        if name not in each.scores:
            raise UsageError(
                f"{each.source} has no score {name!r}",
                fix=nearest(name, each.scores) if each.scores else "run it with `scores:`",
            )
        if each.scores[name] != entrants[0].scores[name]:
            raise UsageError(
                f"{each.source} declares {name} otherwise than {entrants[0].source}",
                fix="run both with one version",
            )
    return entrants[0].scores[name]


def measured(
    real: Sequence[RealResult], entrants: Sequence[Entrant], spec: ScoreSpec | None = None
) -> list[Measured]:
    """Return each policy's success in the two worlds, over the scenes that it met on the robot.

    Scenes weigh equally. As trials count as many as would leave a mean that uncertain in one scene:
    S^2 / (1 / n_1 + .. + 1 / n_S).

    Args:
        real: of the robot.
        entrants: of the simulator, at least one.
        spec: of a score instead of success, which then is also 0 to 1, 1 the best.

    Raises:
        UsageError: a policy or scene of the robot's is none of the simulator's, or is two.
        IncomparableError: the simulator's differ in suite, scenes or simulator.
    """
    check_alike(entrants)
    policies: dict[str, list[RealResult]] = {}
    for each in real:
        policies.setdefault(each.policy, []).append(each)
    return [
        _measured(policy, results, _entrant(results[0], entrants), spec)
        for policy, results in policies.items()
    ]


def _measured(
    policy: str, results: Sequence[RealResult], entrant: Entrant, spec: ScoreSpec | None
) -> Measured:
    simulated: list[list[float]] = []
    for each in results:
        scores = [
            _counted(result, spec)
            for name, result in entrant.results.items()
            if name[0] == each.scene
        ]
        if not scores:
            raise UsageError(
                f"{each.place}: {entrant.source} has no result in scene {each.scene!r}",
                fix=nearest(each.scene, entrant.key.scenes),
            )
        simulated.append(scores)
    return Measured(
        policy=policy,
        real=float(np.mean([each.success for each in results])),
        real_trials=_effective([each.trials for each in results]),
        simulated=float(np.mean([np.mean(scores) for scores in simulated])),
        simulated_trials=_effective([len(scores) for scores in simulated]),
    )


def _counted(result: Row | Start, spec: ScoreSpec | None) -> float:
    """Return what a trial counts, 0 to 1."""
    if spec is None:
        return float(result.success or 0.0)
    failed = result.outcome == "policy_failed"
    return spec.scaled(None if failed else dict(result.scores).get(spec.name))


def _entrant(result: RealResult, entrants: Sequence[Entrant]) -> Entrant:
    """Return the one that a line of the robot's means: by its policy's name, or by its own."""
    known = {_own_name(each) for each in entrants} | {each.policy for each in entrants}
    candidates = [each for each in entrants if result.policy == _own_name(each)] or [
        each for each in entrants if result.policy == each.policy
    ]
    if not candidates:
        raise UsageError(
            f"{result.place}: policy {result.policy!r} is that of no run",
            fix=nearest(result.policy, known),
        )
    if len(candidates) > 1:
        raise UsageError(
            f"{result.place}: policy {result.policy!r} may be {candidates[0].source} or "
            f"{candidates[1].source}",
            fix="call it by the name of its run's folder",
        )
    return candidates[0]


def _own_name(entrant: Entrant) -> str:
    """Return the name of a run's folder, or of a baseline without its suffix."""
    return Path(entrant.source).name.removesuffix(".parquet")


def _effective(trials: Sequence[int]) -> int:
    return max(1, round(len(trials) ** 2 / sum(1.0 / n for n in trials)))
