"""Running: a suite through its trials, or one recorded trial again."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nw_eval.api.message import Message
from nw_eval.api.plans import check_workers, plan
from nw_eval.api.reports import RunReport, report
from nw_eval.errors import StoreError, UsageError
from nw_eval.request import Request
from nw_eval.traceback_file import TracebackIn

if TYPE_CHECKING:
    from nw_eval.engine.listener import Listener


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
    from nw_eval.api.saved_run import continued
    from nw_eval.engine import session
    from nw_eval.engine.workers.presence import Presence

    check_workers(workers)
    if resume is not None and out is not None:
        raise UsageError("--out and --resume exclude each other", fix="drop --out")
    request = Request.of(request, **changes)
    if in_process:
        _check_in_process(request, workers)
    folder = session.run(
        plan(request) if resume is None else continued(resume, request),
        workers=workers,
        out=out,
        resume=resume,
        command=tuple(sys.argv),
        listener=listener,
        in_process=in_process,
    )
    with TracebackIn(folder.path):
        judged = report(folder.path)
    # Writing a report into a folder that was removed makes it anew.
    Presence(folder.journal).check()
    return judged


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
    if request.time_limit is not None:
        raise UsageError(
            f"--time-limit {request.time_limit:g} with --in-process: nobody could end the trial",
            fix="drop one of them",
        )


def replay(
    log: Path,
    *,
    policy: str | None = None,
    checkpoint: Path | None = None,
    start: float = 0.0,
    picture: Path | None = None,
    allow_code: bool = False,
) -> Message:
    """Run a recorded trial again and compare its end bit for bit; exit code 4 if it differs.

    Raises:
        UsageError: there is no such file.
        StoreError: the log cannot be read.
        PolicyError, SceneError, UsageError: policy or scene are missing or not as recorded.
    """
    from nw_eval.rollout.replaying.apart import replay_apart

    if not log.is_file():
        raise UsageError(
            f"{log} is {'a folder' if log.is_dir() else 'no file'}",
            fix="name a trial's log, such as RUN/mcap/SCENE/TRIAL.mcap",
        )
    replayed = replay_apart(
        log,
        policy=policy,
        checkpoint=checkpoint,
        start=start,
        allow_code=allow_code,
        picture=picture is not None,
    )
    text = replayed.text
    if picture is not None and replayed.picture is not None:
        from nw_eval.rollout.replaying.contact_sheet import write_picture

        write_picture(replayed.picture, picture)
        text += f"\n{picture}"
    return Message(text=text, exit_code=0 if replayed.is_identical else StoreError.exit_code)
