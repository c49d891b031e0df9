"""Running: a suite through its trials."""

from __future__ import annotations

import sys
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

from nw_eval.api.running.plans import check_workers, plan
from nw_eval.api.running.reports import RunReport, report
from nw_eval.errors import UsageError
from nw_eval.files.traceback_file import TracebackIn
from nw_eval.request import Request
from nw_eval.rollout.confined.start import prepare

if TYPE_CHECKING:
    from nw_eval.engine.listener import Listener
    from nw_eval.engine.plan import Plan
    from nw_eval.results.run_folder import RunFolder


def run(
    request: Request | str | Path | None = None,
    *,
    workers: int | None = None,
    out: Path | None = None,
    resume: Path | None = None,
    in_process: bool = False,
    listener: Listener | None = None,
    **changes: Any,
) -> RunReport:
    """Roll a checkpoint out through a suite, write the evidence, and judge it.

    `run("hurdles", policy="stand")` is `run(Request(suite="hurdles", policy="stand"))`.

    Args:
        request: what to run, or only its suite: a file or the name of a shipped one; None only
            with `resume`.
        workers: processes; one for each core if None.
        out: the run's folder; a new one in `reports/` if None.
        resume: the folder of an interrupted run, whose finished trials are kept. What the request
            does not ask for is as the run was begun, but for leave to run code.
        in_process: run trials in this very process, one after another, for a debugger or a
            notebook: nothing confines the policy, and nothing ends it if it hangs.
        listener: hears of progress.
        changes: fields of `Request` by name.

    Raises:
        UsageError, SuiteError, SceneError, PolicyError: nothing was run.
        IncomparableError: the run to resume was made under something else.
        StoreError: results cannot be written; those that were written stay.
    """
    from nw_eval.api.running.saved_run import continued

    check_workers(workers)
    if resume is not None and out is not None:
        raise UsageError("--out and --resume exclude each other", fix="drop --out")
    request = Request.of(request, **changes)
    if in_process:
        _check_in_process(request, workers)
    elif not request.allow_code:
        prepare()  # It takes as long as planning does.
    return judged(
        roll_out(
            plan(request) if resume is None else continued(resume, request),
            workers=workers,
            out=out,
            resume=resume,
            in_process=in_process,
            listener=listener,
        )
    )


def roll_out(
    plan: Plan,
    *,
    workers: int | None,
    out: Path | None,
    resume: Path | None,
    in_process: bool,
    listener: Listener | None,
) -> RunFolder:
    """Run what is planned: against a bank, in rounds, until bar and baseline are settled.

    Args:
        plan: what is to be run.
        workers: as for `run`, and so are the others.
        out: the run's folder.
        resume: the folder of an interrupted run.
        in_process: whether trials run in this very process.
        listener: hears of progress.

    Raises:
        IncomparableError, StoreError, SceneError, TrialError, PrerequisiteError: as `run`.
    """
    from nw_eval.api.running.against.contest import Contest
    from nw_eval.engine import session
    from nw_eval.engine.listener import Silence

    ears, command = listener or Silence(), tuple(sys.argv)
    contest = None
    if plan.against is not None:
        contest = Contest(plan, plan.against, workers=workers, command=command, listener=ears)
    elif plan.suite.gate.max_drop is not None:
        ears.message(_without_baseline(plan))
    return session.carry_out(
        plan,
        workers=workers,
        out=out,
        resume=resume,
        command=command,
        listener=ears,
        in_process=in_process,
        prelude=None if contest is None else contest.begin,
        enough=None if contest is None else contest.enough,
    )


def _without_baseline(plan: Plan) -> str:
    """Return what a run leaves unjudged that its suite asks for."""
    suite, policy = plan.suite, plan.bundle.name
    judged_by = "only the bar is judged" if suite.gate.success_rate else "nothing is judged"
    name = suite.name if plan.request.suite is None else str(plan.request.suite)
    return (
        f"no baseline to compare with: {judged_by}, not max_drop {suite.gate.max_drop:g}; "
        f"`nw-eval baseline save {quote(name)} --policy {quote(policy)}` saves one"
    )


def _check_in_process(request: Request, workers: int | None) -> None:
    """Refuse what one process cannot do.

    Raises:
        UsageError: more workers than one, or a limit that nobody could hold a trial to.
    """
    if workers not in {None, 1}:
        raise UsageError(
            f"--workers {workers} with --in-process: it runs one trial after another",
            fix="drop one of them",
        )
    check_limits(request, "--in-process")


def check_limits(request: Request, door: str) -> None:
    """Refuse limits to trials that run in this very process.

    Args:
        request: what is asked for.
        door: why they do, in words.

    Raises:
        UsageError: there is a limit that nobody could hold a trial to.
    """
    time, memory = request.time_limit, request.memory_limit
    limits = [] if time is None else [f"--time-limit {time:g}"]
    limits += [] if memory is None else [f"--memory-limit {memory}"]
    if limits:
        raise UsageError(
            f"{' and '.join(limits)} with {door}: nobody could end the trial",
            fix="drop one of them",
        )


def judged(folder: RunFolder) -> RunReport:
    """Judge a run that has just ended.

    Raises:
        StoreError: its folder was removed, or the report cannot be written.
    """
    from nw_eval.engine.workers.presence import Presence

    with TracebackIn(folder.path):
        outcome = report(folder.path)
    # Writing a report into a folder that was removed makes it anew.
    Presence(folder.journal).check()
    return outcome
