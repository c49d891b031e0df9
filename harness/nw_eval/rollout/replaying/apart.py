"""Replays a trial in a confined process: a log may be a stranger's, and what it names too."""

from __future__ import annotations

from base64 import b64decode, b64encode
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nw_eval.errors import PolicyError, UsageError
from nw_eval.rollout.confined.access import running_rules
from nw_eval.rollout.confined.isolated import call_isolated
from nw_eval.rollout.library import Library
from nw_eval.rollout.replaying.logged import agreed
from nw_eval.rollout.replaying.replay import check_start, replay

_TIME_LIMIT = 3600.0
"""Seconds; a trial of 12 s takes 5 to 30."""


@dataclass(frozen=True, kw_only=True)
class ReplayReport:
    """What came of a replay, as plain values."""

    text: str
    is_identical: bool
    picture: bytes | None
    """The trial's contact sheet, a PNG, if it was asked for."""


def replay_apart(
    path: Path,
    *,
    start: float = 0.0,
    policy: str | None = None,
    checkpoint: Path | None = None,
    allow_code: bool = False,
    picture: bool = False,
) -> ReplayReport:
    """As `replay`, in a process of its own; with a picture if asked for.

    This process reads the log's words and makes the scene, whose cache is out of the other's reach.

    Raises:
        NwEvalError: as `replay`; the policy took more time or memory than it may.
        UsageError: CUDA must draw what it sees, and the caller does not allow code.
    """
    check_start(start)
    library = Library()
    logged = agreed(
        path, policy=policy, checkpoint=checkpoint, allow_code=allow_code, library=library
    )
    job = logged.job
    bundle, scene = library.bundle(job.policy, job.checkpoint), library.scene(job.scene)
    sees = bool(bundle.card.splat_images)
    renders = (sees or picture) and scene.splat is not None
    if renders and job.render == "cuda" and not allow_code:
        # A log's word may not take the fence away, and the driver needs more than it lets through.
        raise UsageError(
            f"{path}: its pictures were drawn with CUDA, which no fence can be put round",
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
        picture=picture,
    )
    try:
        drawn = answer["picture"]
        return ReplayReport(
            text=str(answer["text"]),
            is_identical=answer["identical"] is True,
            picture=None if drawn is None else b64decode(drawn, validate=True),
        )
    except (KeyError, TypeError, ValueError):
        raise PolicyError(
            f"{path}: the replay gave no answer that can be read", fix="do not use this checkpoint"
        ) from None


def _replay(
    *,
    log: str,
    start: float,
    policy: str | None,
    checkpoint: str | None,
    allow_code: bool,
    picture: bool,
) -> dict[str, Any]:
    replayed = replay(
        Path(log),
        start=start,
        policy=policy,
        checkpoint=None if checkpoint is None else Path(checkpoint),
        allow_code=allow_code,
    )
    drawn = None
    if picture:
        from nw_eval.rollout.replaying.contact_sheet import contact_sheet

        drawn = b64encode(contact_sheet(replayed.logged)).decode()
    return {"text": replayed.text, "identical": replayed.is_identical, "picture": drawn}
