"""Replaying: one recorded trial again, compared bit for bit."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from nw_eval.rollout.replaying.report import ReplayReport


def replay(
    log: Path,
    *,
    policy: str | None = None,
    checkpoint: Path | None = None,
    start: float = 0.0,
    picture: Path | None = None,
    allow_code: bool = False,
) -> ReplayReport:
    """Run a recorded trial again, in a process of its own, and compare its end bit for bit.

    Args:
        log: the trial's MCAP file.
        policy: the bundle that made it, where it has moved since, or is served elsewhere.
        checkpoint: weights that were used instead of the card's.
        start: seconds; greater than 0 begins with the last recorded state at or before it.
        picture: where to draw the trial's contact sheet, a PNG; None = nowhere.
        allow_code: whether Python code that the card names may be imported.

    Raises:
        UsageError: there is no such file, `start` is no time, or the scene has changed.
        StoreError: the log cannot be read, or the picture not written.
        PolicyError: the policy is missing or not the recorded one.
        SceneError: the scene is missing.
    """
    from nw_eval.errors import UsageError
    from nw_eval.rollout.replaying.apart import replay_apart

    if not log.is_file():
        raise UsageError(
            f"{log} is {'a folder' if log.is_dir() else 'no file'}",
            fix="name a trial's log, such as RUN/mcap/SCENE/TRIAL.mcap",
        )
    return replay_apart(
        log,
        policy=policy,
        checkpoint=checkpoint,
        start=start,
        allow_code=allow_code,
        picture=picture,
    )
