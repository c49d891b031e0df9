"""Runs trials of a run again, in a folder of their own, by the run's own plan."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from nw_eval.api.verifying.compare import compared
from nw_eval.api.verifying.result import Repeats
from nw_eval.api.verifying.sample import draw
from nw_eval.errors import IncomparableError, NwEvalError, PolicyError, UsageError
from nw_eval.results.journal import JournalHeader, read_journal
from nw_eval.results.provenance import read_run_info

if TYPE_CHECKING:
    from nw_eval.engine.listener import Listener
    from nw_eval.engine.plan import Plan
    from nw_eval.request import Request
    from nw_eval.results.provenance import RunInfo
    from nw_eval.results.row import Row
    from nw_eval.results.run_folder import RunFolder


def run_again(
    folder: RunFolder,
    info: RunInfo,
    rows: Mapping[str, Row],
    request: Request,
    *,
    sample: str,
    seed: int,
    workers: int | None,
    listener: Listener | None,
) -> Repeats:
    """Run trials of a run again, and compare what they come to with their rows and logs.

    Args:
        folder: of the run, in which nothing is written.
        info: its run.json.
        rows: of its trials, by their ids.
        request: where the policy lies, if not where it did, and whether code is allowed.
        sample: how many trials, as `sample.check_sample` has it.
        seed: draws them.
        workers: processes; one for each core if None.
        listener: hears of progress.
    """
    ended = [name for name, row in rows.items() if row.status == "ok"]
    if not ended:
        return Repeats(seed=seed, of=0)
    try:
        plan = _plan(folder, info, request)
        chosen = _part(plan, draw(ended, sample, seed), rows)
        with TemporaryDirectory(prefix="nw-eval-verify-") as temporary:
            return _compared(
                chosen, Path(temporary), folder, rows, seed, len(ended), workers, listener
            )
    except NwEvalError as error:
        return Repeats(seed=seed, of=len(ended), unable=error)


def _plan(folder: RunFolder, info: RunInfo, request: Request) -> Plan:
    """Return the plan of a run, if its trials give the same bits here.

    Raises:
        IncomparableError: policy, scenes, versions, kind of CPU or code are others.
        PolicyError: the policy cannot be run again, or is on a server that the run alone names.
        UsageError: CUDA must draw, and the caller does not allow code.
    """
    from nw_eval.api.running.saved_run import continued
    from nw_eval.engine.provenance import journal_header

    if request.policy is None and not info.policy.card:
        raise PolicyError(
            f"policy {info.policy.name!r} was an object of the process that ran it",
            fix="name a bundle that does the same with --policy",
        )
    plan = continued(folder.path, request)
    if request.policy is None and plan.bundle.card.adapter == "remote":
        raise PolicyError(
            f"{plan.bundle.where}, which run.json names, asks a policy on a server",
            fix=f"add --policy {plan.bundle.where} if you trust it",
        )
    if plan.renders and plan.render == "cuda" and not request.allow_code:
        raise UsageError(
            "its pictures were drawn with CUDA, which cannot be confined",
            fix="add --allow-code if you trust the run and its policy",
        )
    recorded = JournalHeader(
        suite_digest=info.suite_digest,
        policy_digest=info.policy.card_digest,
        scene_digests={name: scene.digest for name, scene in info.scenes.items()},
        engine=info.engine,
    )
    if differences := recorded.differences(journal_header(plan)):
        raise IncomparableError(
            f"trials cannot be compared bit for bit here: {', '.join(differences)} changed",
            fix="verify the run with the nw-eval and on the kind of machine that made it",
        )
    return plan


def _part(plan: Plan, names: tuple[str, ...], rows: Mapping[str, Row]) -> Plan:
    """Return a plan with some of its trials, and nothing to compare them with but their rows."""
    trials = tuple(trial for trial in plan.trials if trial.id in names)
    scenes = {trial.scene for trial in trials}
    return replace(
        plan,
        trials=trials,
        found=tuple(each for each in plan.found if each.scene.name in scenes),
        arm=rows[names[0]].arm,
        against=None,
        is_baseline=False,
    )


def _compared(
    plan: Plan,
    temporary: Path,
    folder: RunFolder,
    rows: Mapping[str, Row],
    seed: int,
    of: int,
    workers: int | None,
    listener: Listener | None,
) -> Repeats:
    """Run a plan and compare each of its rows."""
    from nw_eval.engine import session

    now = session.carry_out(
        plan,
        workers=workers,
        out=temporary / "run",
        resume=None,
        cache=False,  # It may have taken in the very results that are to be verified.
        command=tuple(sys.argv),
        listener=listener,
    )
    again = {row.trial_id: row for row in read_journal(now.journal).rows}
    return Repeats(
        seed=seed,
        of=of,
        trials=tuple(
            compared(rows[name], again[name], run=folder, now=now) for name in sorted(again)
        ),
        interrupted=read_run_info(now.run_json).interrupted,
    )
