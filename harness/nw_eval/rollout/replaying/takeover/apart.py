"""Lets a policy take over in a confined process; so does blame, for which see `blame_apart`."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from nw_eval.errors import PolicyError
from nw_eval.rollout.confined.isolated import call_isolated
from nw_eval.rollout.library import Library
from nw_eval.rollout.replaying.film.film import Film
from nw_eval.rollout.replaying.logged import read_logged_trial
from nw_eval.rollout.replaying.moment import check_inside, check_start
from nw_eval.rollout.replaying.readied import TIME_LIMIT, fetch, readied, scratch_folder
from nw_eval.rollout.replaying.takeover.report import TakeoverReport
from nw_eval.rollout.replaying.takeover.takeover import OPTION, second_job, take_over

_LOG, _VIDEO = "trial.mcap", "trial.mp4"


def take_over_apart(
    path: Path,
    *,
    start: float,
    policy: str | None = None,
    checkpoint: Path | None = None,
    allow_code: bool = False,
    out: Path | None = None,
    video: Path | None = None,
) -> TakeoverReport:
    """As `take_over`, in a process of its own.

    Raises:
        NwEvalError: as `take_over`; the policy took more time or memory than it may.
        PrerequisiteError: a video is asked for, and PyAV is not installed.
        StoreError: log or video cannot be written.
        UsageError: CUDA must draw what it sees, and the caller does not allow code.
    """
    check_start(start, option=OPTION)
    library = Library()
    check_inside(start, read_logged_trial(path), option=OPTION)
    job = second_job(
        path, policy=policy, checkpoint=checkpoint, allow_code=allow_code, library=library
    )
    draws = out is not None or video is not None  # A log's own camera draws, too.
    with scratch_folder() as folder:
        ready = readied(job, path, library, draws=draws, folder=folder)
        answer = call_isolated(
            _take_over,
            subject=str(path),
            rules=ready.rules,
            time_limit=TIME_LIMIT,
            renders=ready.renders,
            policy_process=ready.policy,
            log=str(path.resolve()),
            start=start,
            policy=policy,
            checkpoint=None if checkpoint is None else str(checkpoint),
            allow_code=allow_code,
            out=None if out is None else str(folder / _LOG),
            video=None if video is None else str(folder / _VIDEO),
        )
        try:
            report = TypeAdapter(TakeoverReport).validate_python(answer)
        except ValueError:
            raise PolicyError(
                f"{path}: the take-over gave no answer that can be read",
                fix="do not use this checkpoint",
            ) from None
        if out is not None:
            fetch(folder / _LOG, out)
        if video is not None:
            fetch(folder / _VIDEO, video)
    return replace(report, log=out, video=video)


def _take_over(
    *,
    log: str,
    start: float,
    policy: str | None,
    checkpoint: str | None,
    allow_code: bool,
    out: str | None,
    video: str | None,
) -> dict[str, Any]:
    taken = take_over(
        Path(log),
        start=start,
        policy=policy,
        checkpoint=None if checkpoint is None else Path(checkpoint),
        allow_code=allow_code,
        out=None if out is None else Path(out),
        film=None if video is None else Film(Path(video)),
    )
    return asdict(taken.report)
