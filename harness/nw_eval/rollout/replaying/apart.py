"""Replays a trial in a confined process: a log may be a stranger's, and what it names too."""

from __future__ import annotations

from base64 import b64decode, b64encode
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from nw_eval.errors import PolicyError, UsageError
from nw_eval.files.cache import atomic_path
from nw_eval.rollout.confined.access import running_rules
from nw_eval.rollout.confined.isolated import call_isolated
from nw_eval.rollout.library import Library
from nw_eval.rollout.replaying.logged import agreed
from nw_eval.rollout.replaying.replay import check_inside, check_start, replay
from nw_eval.rollout.replaying.report import ReplayReport

_TIME_LIMIT = 3600.0
"""Seconds; a trial of 12 s takes 5 to 30."""


def replay_apart(
    path: Path,
    *,
    start: float = 0.0,
    policy: str | None = None,
    checkpoint: Path | None = None,
    allow_code: bool = False,
    picture: Path | None = None,
) -> ReplayReport:
    """As `replay`, in a process of its own; draws the trial's contact sheet if asked for.

    This process reads the log's words and makes the scene, whose cache is out of the other's reach.

    Raises:
        NwEvalError: as `replay`; the policy took more time or memory than it may.
        StoreError: the picture cannot be written.
        UsageError: CUDA must draw what it sees, and the caller does not allow code.
    """
    check_start(start)
    library = Library()
    logged = agreed(
        path, policy=policy, checkpoint=checkpoint, allow_code=allow_code, library=library
    )
    check_inside(start, logged)
    job = logged.job
    bundle = library.bundle(job.policy, job.checkpoint)
    scene = library.scene(job.scene, job.collision)
    renders = (bool(bundle.card.splat_images) or picture is not None) and scene.splat is not None
    if renders and job.render == "cuda" and not allow_code:
        # A log's word may not take the fence away, and the driver needs more than it lets through.
        raise UsageError(
            f"{path}: its pictures were drawn with CUDA, which cannot be confined",
            fix="add --allow-code if you trust the log and the policy",
        )
    if renders:
        scene.splat_store()
    rules = running_rules(bundle, scenes=[job.scene], allow_code=allow_code, also=[path])
    answer = call_isolated(
        _replay,
        subject=str(path),
        rules=rules,
        time_limit=_TIME_LIMIT,
        renders=renders,
        log=str(path.resolve()),
        start=start,
        policy=policy,
        checkpoint=None if checkpoint is None else str(checkpoint),
        allow_code=allow_code,
        draws=picture is not None,
    )
    try:
        report = TypeAdapter(ReplayReport).validate_python(answer["report"])
        drawn = None if picture is None else b64decode(answer["picture"], validate=True)
    except (KeyError, TypeError, ValueError):
        raise PolicyError(
            f"{path}: the replay gave no answer that can be read", fix="do not use this checkpoint"
        ) from None
    if picture is None or drawn is None:
        return report
    with atomic_path(picture) as temporary:
        temporary.write_bytes(drawn)
    return replace(report, picture=picture)


def _replay(
    *,
    log: str,
    start: float,
    policy: str | None,
    checkpoint: str | None,
    allow_code: bool,
    draws: bool,
) -> dict[str, Any]:
    replayed = replay(
        Path(log),
        start=start,
        policy=policy,
        checkpoint=None if checkpoint is None else Path(checkpoint),
        allow_code=allow_code,
    )
    drawn = None
    if draws:
        from nw_eval.rollout.replaying.contact_sheet import contact_sheet

        drawn = b64encode(contact_sheet(replayed.logged)).decode()
    return {"report": asdict(replayed.report), "picture": drawn}
