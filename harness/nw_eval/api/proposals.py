"""Suites that are written from what was measured: by `nw-eval plan` and by `nw-eval limits`."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nw_base.errors import IncomparableError, UsageError
from nw_eval.suite.load import entry_from, suite_name, write_suite
from nw_sim.tasks.track import with_motion

if TYPE_CHECKING:
    from nw_eval.engine.plan import Plan
    from nw_eval.reporting.html.limits import LadderLimit
    from nw_eval.suite import Suite
    from nw_gate.baseline.informative import Proposal
    from nw_gate.results.baseline import BaselineKey
    from nw_gate.stats.power import SceneCounts

_ENOUGH = 6
"""Trials at a rung, at least, for its rate to count."""
_TRIALS = 10
"""Of each rung of a suite of limits."""


@dataclass(frozen=True, kw_only=True)
class MeasuredPolicy:
    """The policy whose results a plan is made from."""

    source: str
    """Where they are, as text."""
    name: str
    typed: str
    """What a suite calls it; empty where that is not known."""
    digests: tuple[str, str]
    """Of its checkpoint and of its card."""
    key: BaselineKey
    """What its results hold for."""


@dataclass(frozen=True, kw_only=True)
class MeasuredRungs:
    """Rungs of which saved trials say how often a policy completes them."""

    rungs: tuple[tuple[str, SceneCounts], ...] = ()
    """The scene of each, as a suite names it, and trials that stand for its rate."""
    seeds: tuple[int, ...] = ()
    """Seeds of these trials."""


def measured_rungs(
    folders: Sequence[Path], policy: MeasuredPolicy, robot: str, known: Sequence[str]
) -> MeasuredRungs:
    """Return the rungs that searches for limits have tried often enough.

    A rung's rate is that of its ladder's curve: the search chose its trials by their results, and
    the curve is moved less by a few lucky ones.

    Args:
        folders: of `nw-eval limits`.
        policy: whose trials count; others of these searches are ignored.
        robot: of the suite.
        known: scenes that the suite has already.

    Raises:
        UsageError: a folder holds no limits; or none of this policy.
        IncomparableError: the trials are of another robot, protocol or simulator.
        StoreError: a file is damaged.
    """
    from nw_eval.api.saved_limits import read_limits
    from nw_gate.results.baseline import key_of
    from nw_gate.results.provenance import read_run_info
    from nw_gate.results.run_folder import open_run_folder

    rungs: dict[str, SceneCounts] = {}
    seeds: list[int] = []
    for folder in folders:
        others: list[str] = []
        searches = 0
        for each in read_limits(folder):
            run = open_run_folder(each.run)
            info = read_run_info(run.run_json)
            if (info.policy.checkpoint_digest, info.policy.card_digest) != policy.digests:
                others.append(each.policy)
                continue
            own, searches = key_of(info), searches + 1
            for what, here, there in (
                ("robot", str(info.suite.get("robot")), robot),
                ("protocol", own.protocol, policy.key.protocol),
                *(
                    (name, own.simulator.get(name), version)
                    for name, version in policy.key.simulator.items()
                ),
            ):
                if here != there:
                    raise IncomparableError(
                        f"{each.run}: its {what} is {here}, that of the baseline is {there}",
                        fix="find the limits again with `nw-eval limits`",
                    )
            seeds.append(own.seed)
            rungs.update(_rungs(each, run.path, known))
        if not searches:
            raise UsageError(
                f"{folder} holds limits of {', '.join(dict.fromkeys(others))} and none of "
                f"{policy.name}, whose results the suite is planned with",
                fix=f"nw-eval limits LADDER -p {policy.typed or policy.name}",
            )
    return MeasuredRungs(rungs=tuple(rungs.items()), seeds=tuple(seeds))


def _rungs(saved: LadderLimit, run: Path, known: Sequence[str]) -> dict[str, SceneCounts]:
    """Return the rungs of one ladder of scenes by what a suite calls them."""
    from nw_eval.api.saved_run import saved_rows
    from nw_gate.baseline.informative import rung_counts
    from nw_gate.results.provenance import read_run_info
    from nw_gate.results.run_folder import open_run_folder
    from nw_sim.ladders import rungs_of

    folder = open_run_folder(run)
    rows = saved_rows(folder, read_run_info(folder.run_json))
    waypoints = {row.scene: max(1, row.waypoints_total) for row in rows}
    named = {rung.value: rung for rung in rungs_of(saved.ladder)}
    found: dict[str, SceneCounts] = {}
    for point in saved.limit.curve:
        rung = named.get(point.value)
        if rung is None or rung.perturbation or rung.scene in known or point.tried < _ENOUGH:
            continue
        # A folder's rung is a scene of another name: all rungs of a ladder are one course.
        course = waypoints.get(rung.scene, max(waypoints.values()))
        found[rung.scene] = rung_counts(point.rate, course)
    return found


def ladders_like(scenes: Sequence[str]) -> tuple[str, ...]:
    """Return the built-in ladders of the classes that scenes belong to."""
    from nw_sim.ladders import ladders

    classes = {scene.partition("/")[0] for scene in scenes}
    known = [each for each in ladders() if "+" not in each.name]
    return tuple(each.name for each in known if each.name.partition("/")[0] in classes)


def check_name(file: Path, suite: str) -> None:
    """Refuse a file whose suite would be called as the one that it is made from.

    Raises:
        UsageError: it would.
    """
    if suite_name(file.stem) == suite:
        raise UsageError(
            f"--write-suite {file}: a suite {suite!r} is what it was planned with",
            fix="give the file another name, which becomes the suite's",
        )


def write_proposal(
    file: Path, plan: Plan, proposal: Proposal, policy: MeasuredPolicy, seeds: Sequence[int]
) -> None:
    """Write the suite of a proposal.

    Its seed is another than that of all results which its scenes were chosen by.

    Args:
        file: of the suite.
        plan: of the suite that it was made from.
        proposal: what it has.
        policy: that was measured.
        seeds: of its searches for limits.

    Raises:
        StoreError: it cannot be written.
    """
    suite = plan.suite
    references = {found.scene.name: found.reference for found in plan.found}
    gate = suite.gate
    left = {"success_rate", "baseline", "tiers", "max_drop", "rounds"}
    settings: dict[str, Any] = suite.model_dump(by_alias=True, exclude_defaults=True)
    own = suite.source.base
    is_place = suite.robot.startswith((".", "/"))
    settings |= {
        # By its kind alone a reader knows of which task the other keys are.
        **({"task": _task_from(file.parent, suite)} if "task" in settings else {}),
        "robot": entry_from(file.parent, suite.robot, own) if is_place else suite.robot,
        "nw-eval": 1,
        "name": suite_name(file.stem),
        "policy": entry_from(file.parent, policy.typed)
        if policy.typed
        else entry_from(file.parent, suite.policy, own),
        "trials": max(1, suite.trials * len(plan.found) // len(proposal.items)),
        "seed": max([suite.seed, *seeds]) + 1,
        "scenes": [
            entry_from(file.parent, references.get(each.stratum[0], each.stratum[0]))
            for each in proposal.items
        ],
        "gate": {
            "max_drop": gate.most_drop,
            **{key: x for key, x in settings.get("gate", {}).items() if key not in left},
            "rounds": proposal.rounds,
        },
    }
    if limits := settings["gate"].get("limits"):
        settings["gate"]["limits"] = {
            _ladder_from(file.parent, name, own): asked for name, asked in limits.items()
        }
    if critical := [each.stratum[0] for each in proposal.items if each.critical]:
        settings["gate"]["tiers"] = dict.fromkeys(critical, "critical")
    lines = [
        f"The scenes of {suite.name} and rungs of ladders that tell policies apart, by the results",
        f"of {policy.name}. Its seed is another one, so that no result chose its own comparison.",
    ]
    write_suite(file, settings, _head(lines, file, policy.typed, policy.name, proposal.starts))


def _task_from(folder: Path, suite: Suite) -> dict[str, Any]:
    """Return the task of a suite as one of another folder names it."""
    task = suite.task
    if suite.motion is not None:
        place = Path(os.path.relpath(suite.motion, folder)).as_posix()
        task = with_motion(task, lambda _: place)
    return {"kind": task.kind, **task.model_dump(exclude_defaults=True)}


def _ladder_from(folder: Path, name: str, base: Path) -> str:
    """Return what names a ladder in a suite of a folder: a name, a folder, or `SCENE+AXIS`."""
    scene, plus, axis = name.rpartition("+")
    return f"{entry_from(folder, scene if plus else axis, base)}{plus}{axis if plus else ''}"


def write_limits_suite(
    file: Path, limits: Sequence[LadderLimit], *, robot: str, policy: str, seed: int
) -> tuple[str, ...]:
    """Write a suite of the rungs around limits: from the last cleared one to the first failed one.

    Args:
        file: of the suite.
        limits: of the policy.
        robot: as a suite names it from the working folder.
        policy: as it was asked for.
        seed: of the searches; the suite has another one.

    Returns:
        Ladders that it has no rung of: the policy clears none or all of their rungs, or their rungs
        are no scenes.

    Raises:
        UsageError: no ladder has a rung for it.
        StoreError: it cannot be written.
    """
    from nw_sim.ladders import rungs_of

    scenes: list[str] = []
    left: list[str] = []
    for each in limits:
        low, high = each.limit.ends
        values = each.limit.ladder.rungs[max(0, low) : high + 1]
        named = {rung.value: rung for rung in rungs_of(each.ladder)}
        rungs = [named[value] for value in values if value in named]
        both = low >= 0 and high < len(each.limit.ladder.rungs)
        if both and rungs and not any(rung.perturbation for rung in rungs):
            scenes += [entry_from(file.parent, rung.scene) for rung in rungs]
        else:
            left.append(each.ladder)
    if not scenes:
        raise UsageError(
            f"--write-suite {file}: no ladder has a limit with two bounds; the limits themselves "
            f"are in {limits[0].run.parents[1]}",
            fix="climb other ladders",
        )
    settings: dict[str, Any] = {
        "nw-eval": 1,
        "name": suite_name(file.stem),
        "robot": entry_from(file.parent, robot),
        "policy": entry_from(file.parent, policy),
        "trials": _TRIALS,
        "seed": seed + 1,
        "scenes": scenes,
        "record": "failures",
        "gate": {"max_drop": 0.1},
    }
    lines = [f"Rungs around the limits of {limits[0].policy}. Its seed is not that of the search."]
    write_suite(file, settings, _head(lines, file, policy, suite_name(limits[0].policy)))
    return tuple(left)


def _head(
    lines: Sequence[str], file: Path, policy: str, name: str, starts: int | None = None
) -> str:
    """Return the comments of a suite: what it is, and what makes it judge."""
    more = "" if starts is None else f" --trials {starts}"
    save = f"nw-eval baseline save {file} --policy {policy or 'POLICY'}{more} --name {name}"
    said = [*lines, f"First: {save}", f"Then:  nw-eval run {file} --policy NEW --baseline {name}"]
    return "".join(f"# {line}\n" for line in said)
