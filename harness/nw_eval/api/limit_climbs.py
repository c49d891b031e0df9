"""Climbing the ladders that a suite's gate names: for a run, and for a baseline.

They run once the trials of the scenes have ended, unless these say nothing about the policy.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

from nw_base.errors import TrialError
from nw_base.files.cache import atomic_path
from nw_eval.api.ladder_runs import Climb, ladder_plan_of_run, rung_cells, title_of
from nw_eval.api.limit_gates import (
    MOST_SAVED,
    asked_ladders,
    baseline_search,
    compares,
    holds_here,
    is_of,
    ladder_folders,
    limit_path,
    rules_digest,
)
from nw_eval.suite.ladders import gated_ladder
from nw_gate.limits.limit import Limit
from nw_gate.results.baseline import SavedLimit, machine_of
from nw_gate.results.provenance import read_run_info, write_run_info
from nw_gate.results.run_folder import RunFolder

if TYPE_CHECKING:
    from nw_eval.engine.how import How
    from nw_eval.engine.plan import Plan
    from nw_gate.limits.path import TrialPath
    from nw_gate.results.baseline import LoadedBaseline
    from nw_gate.results.provenance import RunInfo
    from nw_gate.settings import Gate, LadderGate
    from nw_gate.verdict import Verdict
    from nw_sim.ladders import Ladder as SceneLadder


def climb_limits(
    plan: Plan,
    folder: RunFolder,
    how: How,
    *,
    searched: bool = False,
    against: LoadedBaseline | None = None,
) -> None:
    """Run what the ladders of a suite's gate need, after the trials of its scenes.

    Of a run in parts the first part does. Where the run is INVALID or INFRASTRUCTURE, nothing runs,
    unless limits are searched. After a REGRESSED the ladders are climbed, too: they say by how much
    in metres.

    Args:
        plan: of the run.
        folder: of the run, whose trials have ended.
        how: how it is run.
        searched: whether the policy's limit is searched for its own sake, too.
        against: a baseline from other initial states in place of the run's; None = the run's.

    Raises:
        SceneError, PolicyError, IncomparableError, StoreError: as `api.run`.
    """
    from nw_eval.api.loaded_baselines import kept_baseline
    from nw_eval.api.reports import as_begun

    run, began, verdict = read_run_info(folder.run_json), perf_counter(), None
    if run.interrupted or not plan.suite.gate.limits:
        return
    if searched:
        names = asked_ladders(plan.suite, run)
    elif run.is_part:
        names = (
            asked_ladders(plan.suite, run)
            if plan.shard is not None and plan.shard.index == 1
            else ()
        )
    else:
        verdict = as_begun(folder.path).verdict
        lacking = (item for item in verdict.limits if item.word == "INFRASTRUCTURE")
        names = tuple(item.ladder for item in lacking)
    against = against or (kept_baseline(folder, run) if names else None)
    for name in names:
        interrupted = _climb_gated(
            plan, folder, run, name, against, how, searched=searched, verdict=verdict
        )
        wall = run.wall_s + perf_counter() - began
        update = {"wall_s": wall, "interrupted": interrupted}
        write_run_info(folder.run_json, run.model_copy(update=update))
        if interrupted:
            return


def baseline_limits(
    plan: Plan, how: How, work: Path, known: Mapping[str, SavedLimit]
) -> dict[str, SavedLimit]:
    """Return the limits of a plan's policy on the ladders of its suite's gate.

    Args:
        plan: of a baseline.
        how: how its trials run.
        work: the folder of its run, in which an interrupted climb goes on.
        known: limits that were saved earlier, which are kept if they hold.

    Raises:
        KeyboardInterrupt: it was interrupted; the trials that have ended are kept.
        TrialError: a trial produced no result.
        StoreError: results cannot be written.
    """
    from nw_eval.engine.provenance import run_info
    from nw_sim.ladders import ladder_named

    limits: dict[str, SavedLimit] = {}
    for name, at in ladder_folders(RunFolder(path=work), plan.suite.gate).items():
        family, asked = ladder_named(name, plan.suite.base), plan.suite.gate.limits[name]
        if asked.max_drop is None:  # Nothing is compared with a baseline's limit.
            continue
        own = ladder_plan_of_run(family, plan, MOST_SAVED)
        machine = machine_of(run_info(own, RunFolder(path=at), how))
        saved = known.get(name)
        if (
            saved is not None
            and _is_of(saved, own, name, plan.suite.gate)
            and saved.machine == machine
        ):
            limits[name] = saved
            continue
        search = baseline_search(gated_ladder(family), asked, plan.suite.gate)
        how.told.message(f"ladder {name}: its limit is measured for the baseline")
        climb = Climb(own, family, search, how)
        if climb.carry_out(at):
            raise KeyboardInterrupt
        if climb.errors:
            raise TrialError(
                f"ladder {name}: a trial has no result", fix=f"see {at}, and save again"
            )
        limits[name] = SavedLimit(
            limit=search.limit.as_dict(),
            suite_digest=rules_digest(own.suite),
            scenes=_digests(own),
            machine=machine,
        )
    return limits


def _is_of(saved: SavedLimit, own: Plan, ladder: str, gate: Gate) -> bool:
    return is_of(saved, own.suite, _digests(own), ladder, gate)


def _digests(own: Plan) -> dict[str, str]:
    return {scene.name: scene.digest for scene in own.scenes}


def _climb_gated(
    plan: Plan,
    folder: RunFolder,
    run: RunInfo,
    name: str,
    against: LoadedBaseline | None,
    how: How,
    *,
    searched: bool,
    verdict: Verdict | None,
) -> bool:
    """Run what one ladder needs; return whether a signal came first."""
    from nw_sim.ladders import ladder_named

    family, asked = ladder_named(name, plan.suite.base), plan.suite.gate.limits[name]
    at, baseline = ladder_folders(folder, plan.suite.gate)[name], None
    # A candidate's trials begin after those of any baseline: one plan serves beside each of them.
    own = ladder_plan_of_run(family, plan, MOST_SAVED + asked.trials)
    if compares(asked, run, against, verdict):
        assert against is not None, "there is something to compare with"
        saved = against.results.manifest.limits.get(name)
        if (
            saved is not None
            and _is_of(saved, own, name, plan.suite.gate)
            and holds_here(saved, run)
        ):
            baseline = Limit.from_dict(saved.limit)
        elif not searched:
            baseline = _measured(plan, run, family, asked, against, at, how)
            if baseline is None:
                return True
    path = limit_path(asked, plan.suite.gate, gated_ladder(family), baseline, searched=searched)
    if path is None:
        return False
    how.told.message(f"ladder {name}: at most {asked.trials} trials")
    return _climbed(own, family, path, how, at / "candidate", searched=searched)


def _measured(
    plan: Plan,
    run: RunInfo,
    family: SceneLadder,
    asked: LadderGate,
    against: LoadedBaseline,
    at: Path,
    how: How,
) -> Limit | None:
    """Measure the limit of the baseline's policy on this machine; None if a signal came first."""
    from nw_eval.api.baseline_comparison import baseline_bundle

    how.told.message(
        f"ladder {family.name}: baseline {against.info.name} has no limit that holds here; its own "
        "policy climbs it first"
    )
    bundle = baseline_bundle(plan, against, run)
    own = ladder_plan_of_run(family, plan, MOST_SAVED, bundle=bundle)
    search = baseline_search(gated_ladder(family), asked, plan.suite.gate)
    # A policy by its card is behind the fence, also where the candidate is not.
    beside = replace(how, in_process=False, labels=None)
    if _climbed(replace(own, arm="baseline"), family, search, beside, at / "baseline"):
        return None
    return search.limit


def _climbed(
    plan: Plan,
    family: SceneLadder,
    path: TrialPath,
    how: How,
    out: Path,
    *,
    searched: bool = False,
) -> bool:
    """Climb a ladder, and leave beside the run what its rungs are."""
    ladder = {
        "nw-climb": 1,
        "ladder": family.name,
        "title": title_of(family),
        "searched": searched,
        "unit": family.unit,
        "rungs": [rung.value for rung in family.rungs],
        "cells": [[scene, dict(cell)] for scene, cell in rung_cells(plan, family)],
    }
    interrupted = Climb(plan, family, path, how).carry_out(out)
    with atomic_path(out / "ladder.json") as temporary:
        temporary.write_text(json.dumps(ladder, indent=1) + "\n", encoding="utf-8")
    return interrupted
