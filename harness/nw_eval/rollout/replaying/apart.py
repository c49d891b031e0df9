"""Replays a trial in a confined process: a log may be a stranger's, and what it names too."""

from __future__ import annotations

from base64 import b64decode, b64encode
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from nw_eval.errors import PolicyError
from nw_eval.files.cache import atomic_path, followed
from nw_eval.rollout.confined.isolated import call_isolated
from nw_eval.rollout.library import Library
from nw_eval.rollout.replaying.film.film import Film
from nw_eval.rollout.replaying.logged import agreed
from nw_eval.rollout.replaying.moment import check_inside, check_start
from nw_eval.rollout.replaying.readied import TIME_LIMIT, fetch, readied, scratch_folder
from nw_eval.rollout.replaying.replay import replay
from nw_eval.rollout.replaying.report import ReplayReport


def replay_apart(
    path: Path,
    *,
    start: float = 0.0,
    policy: str | None = None,
    checkpoint: Path | None = None,
    allow_code: bool = False,
    picture: Path | None = None,
    video: Path | None = None,
) -> ReplayReport:
    """As `replay`, in a process of its own; draws contact sheet and video if asked for.

    This process reads the log's words and makes the scene, whose cache is out of the other's reach.

    Raises:
        NwEvalError: as `replay`; the policy took more time or memory than it may.
        PrerequisiteError: a video is asked for, and PyAV is not installed.
        StoreError: picture or video cannot be written.
        UsageError: CUDA must draw what it sees, and the caller does not allow code.
    """
    check_start(start)
    library = Library()
    logged = agreed(
        path, policy=policy, checkpoint=checkpoint, allow_code=allow_code, library=library
    )
    check_inside(start, logged)
    draws = picture is not None or video is not None
    with scratch_folder() as folder:
        ready = readied(logged.job, path, library, draws=draws, folder=folder)
        filmed = folder / "trial.mp4"
        answer = call_isolated(
            _replay,
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
            draws=picture is not None,
            video=None if video is None else str(filmed),
        )
        try:
            report = TypeAdapter(ReplayReport).validate_python(answer["report"])
            drawn = None if picture is None else b64decode(answer["picture"], validate=True)
        except (KeyError, TypeError, ValueError):
            raise PolicyError(
                f"{path}: the replay gave no answer that can be read",
                fix="do not use this checkpoint",
            ) from None
        if video is not None:
            fetch(filmed, video)
    if picture is not None and drawn is not None:
        with atomic_path(followed(picture)) as temporary:
            temporary.write_bytes(drawn)
    return replace(report, picture=picture, video=video)


def _replay(
    *,
    log: str,
    start: float,
    policy: str | None,
    checkpoint: str | None,
    allow_code: bool,
    draws: bool,
    video: str | None,
) -> dict[str, Any]:
    replayed = replay(
        Path(log),
        start=start,
        policy=policy,
        checkpoint=None if checkpoint is None else Path(checkpoint),
        allow_code=allow_code,
        film=None if video is None else Film(Path(video)),
    )
    drawn = None
    if draws:
        from nw_eval.rollout.replaying.contact_sheet import contact_sheet

        drawn = b64encode(contact_sheet(replayed.logged)).decode()
    return {"report": asdict(replayed.report), "picture": drawn}
