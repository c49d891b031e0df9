"""From when on a run's failures were not to be averted by a baseline's policy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.api.paths import as_path
from nw_eval.api.renamed import keywords_were

if TYPE_CHECKING:
    from os import PathLike

    from nw_base.errors import NwEvalError
    from nw_gate.results.provenance import RunInfo
    from nw_gate.results.row import Row
    from nw_gate.results.run_folder import RunFolder
    from nw_policies import Bundle
    from nw_sim.rollout.replaying.reports import AttributionReport

AT_MOST = 10
"""Trials that are looked at unless more are asked for: each takes as long as some ten others."""

_START = 5.0  # Wall seconds until a process has its libraries.


@dataclass(frozen=True, kw_only=True)
class AttributedTrial:
    """A trial of a run that failed, and what a baseline makes of it."""

    trial: str
    scene: str
    report: AttributionReport | None
    """None where nothing came of it."""
    fault: str = ""
    """Why not."""


@dataclass(frozen=True, kw_only=True)
class AttributionPlan:
    """Which failures are looked at, and about how long it takes."""

    chosen: int
    failed: int
    """Of the run's trials."""
    without_log: int
    """Of those: nothing can be said of them."""
    baseline: str
    """Who takes over."""
    tries: int
    """In each trial, at most."""
    minutes: float
    """Of wall time, about, at most; computed from what the run's own trials took."""
    workers: int


@dataclass(frozen=True, kw_only=True)
class Attribution:
    """What a baseline makes of a run's failures."""

    run: str
    plan: AttributionPlan
    trials: tuple[AttributedTrial, ...]
    """The worst first, as in the run's report."""


@keywords_were(at_most="trials")
def attribute(
    run: str | PathLike[str],
    *,
    baseline: str,
    policy: str | None = None,
    checkpoint: str | PathLike[str] | None = None,
    trials: int = AT_MOST,
    workers: int | None = None,
    allow_code: bool = False,
    planned: Callable[[AttributionPlan], None] | None = None,
    ended: Callable[[AttributedTrial], None] | None = None,
) -> Attribution:
    """Return for failed trials of a run from when on a baseline does not complete them any more.

    Each trial goes its recorded way once, in a confined process, and the baseline takes over at
    several of its moments.

    Args:
        run: the run's folder, with its logs.
        baseline: a baseline, whose policy takes over; or a policy.
        policy: where the baseline's policy lies, if not where the baseline says.
        checkpoint: weights in place of those that its card names.
        trials: how many; the worst first.
        workers: processes (default: one per core).
        allow_code: whether Python code that the card names may be imported.
        planned: told what is to be done, before anything is.
        ended: told of each trial, as it ends.

    Raises:
        UsageError: it is not a run folder, there is neither baseline nor policy of that name,
            `trials` is not a number of trials, or no failed trial has a log.
        StoreError: run or baseline are damaged.
        IncomparableError: the baseline's policy is not the one that is there.
        PolicyError: the policy cannot be used.
    """
    from nw_base.errors import UsageError
    from nw_eval.engine.machine import worker_count
    from nw_eval.reporting.tables.trials import worst_trials
    from nw_gate.results.evidence_check import present_logs
    from nw_scenes.robots import find_robot, know_robot
    from nw_sim.rollout.confined.vetting import vet_bundle
    from nw_sim.rollout.replaying.apart import attribute_apart

    run = as_path(run)
    checkpoint = as_path(checkpoint)
    if trials < 1:
        raise UsageError(f"--trials {trials} is too low", fix="give at least 1 trial")
    folder, info, rows = _read(run)
    bundle = baseline_bundle(baseline, info, policy=policy, checkpoint=checkpoint)
    robot = None if info.request is None else info.request.robot
    named = str(info.suite.get("robot", ""))
    for each in (robot or named, named):
        know_robot(each, None)  # The run may be untrusted, which fetches nothing.
    if robot is not None:
        find_robot(robot)  # A folder's name is known from then on.
    vet_bundle(bundle, named, allow_code=allow_code)
    failed = worst_trials(rows)
    logs = present_logs(folder, failed)
    chosen = [row for row in failed if row.trial_id in logs][:trials]
    if not chosen:
        raise UsageError(
            f"{run} has no failed trial with a log", fix="name a run that has, with its mcap/"
        )
    count = worker_count(workers, len(chosen))
    plan = AttributionPlan(
        chosen=len(chosen),
        failed=len(failed),
        without_log=len(failed) - len(logs),
        baseline=bundle.name,
        tries=_tries(chosen),
        minutes=_minutes(rows, chosen, info, workers=count),
        workers=count,
    )
    if planned is not None:
        planned(plan)
    attributed: dict[int, AttributedTrial] = {}
    paths = [logs[row.trial_id] for row in chosen]
    for place, what in attribute_apart(
        paths,
        policy=bundle.reference,
        checkpoint=checkpoint,
        allow_code=allow_code,
        workers=count,
    ):
        attributed[place] = _attributed(chosen[place], paths[place], what)
        if ended is not None:
            ended(attributed[place])
    return Attribution(
        run=str(run), plan=plan, trials=tuple(attributed[n] for n in range(len(chosen)))
    )


def _attributed(row: Row, log: Path, what: AttributionReport | NwEvalError) -> AttributedTrial:
    from nw_base.errors import NwEvalError

    report, fault = (None, str(what)) if isinstance(what, NwEvalError) else (what, "")
    if report is not None and report.trial != row.trial_id:
        report, fault = None, f"{log} is the log of another trial"
    return AttributedTrial(trial=row.trial_id, scene=row.scene, report=report, fault=fault)


def _read(run: Path) -> tuple[RunFolder, RunInfo, Sequence[Row]]:
    from nw_eval.api.saved_run import saved_rows
    from nw_gate.results.provenance import read_run_info
    from nw_gate.results.run_folder import open_run_folder

    folder = open_run_folder(run)
    info = read_run_info(folder.run_json)
    return folder, info, saved_rows(folder, info)


def _tries(rows: Sequence[Row]) -> int:
    from nw_sim.rollout.replaying.takeover import most_tries

    return max(most_tries(row.steps) for row in rows)


def _minutes(rows: Sequence[Row], chosen: Sequence[Row], info: RunInfo, *, workers: int) -> float:
    simulated = sum(row.sim_s for row in rows) or 1.0
    pace = sum(row.wall_s for row in rows) / simulated
    duration = float(info.suite.get("episode", {}).get("duration", 0.0))
    each = _START + pace * (1 + _tries(chosen)) * duration
    return len(chosen) * each / workers / 60.0


def baseline_bundle(
    baseline: str, info: RunInfo, *, policy: str | None, checkpoint: Path | None
) -> Bundle:
    """Return the policy that a baseline's name means: that of a baseline, or else one of that name.

    Args:
        baseline: see above; a baseline of the run's own suite goes before a policy.
        info: the run's.
        policy: where the baseline's policy lies.
        checkpoint: weights of it.

    Raises:
        UsageError: there is neither; or no baseline, and a policy is named as well.
        StoreError: the baseline is damaged.
        IncomparableError: the baseline's policy is not the one that is there.
        PolicyError: the policy cannot be loaded.
    """
    from nw_base.errors import IncomparableError, PolicyError, UsageError
    from nw_gate.results.baseline_file import find_baseline, read_baseline
    from nw_policies import find_card, load_bundle

    try:
        saved = read_baseline(find_baseline(baseline, suite=str(info.suite.get("name", ""))))
    except UsageError as error:
        no_baseline = error
    else:
        own = saved.manifest.policy
        bundle = load_bundle(find_card(policy or own.card or own.name), checkpoint=checkpoint)
        if (bundle.checkpoint_digest, bundle.digest) != (own.checkpoint_digest, own.card_digest):
            raise IncomparableError(
                f"baseline {saved.manifest.name} was saved with {own.name} "
                f"({own.checkpoint_digest[:8]}), and {bundle.where} differs "
                f"({bundle.checkpoint_digest[:8]})",
                fix="give its path with --policy and --checkpoint, or name the policy itself "
                "with --baseline",
            )
        return bundle
    if policy is not None:
        raise no_baseline
    try:
        return load_bundle(find_card(baseline), checkpoint=checkpoint)
    except PolicyError as error:
        raise UsageError(f"{no_baseline.message}, and no policy: {error.message}") from None
