"""A trial's log: run again and compared bit for bit, or shown by other programs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nw_eval.rollout.replaying.report import ReplayReport
    from nw_eval.viewing.recording.written import WrittenRecording


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
    from nw_eval.rollout.replaying.apart import replay_apart

    _check_file(log)
    return replay_apart(
        log,
        policy=policy,
        checkpoint=checkpoint,
        start=start,
        allow_code=allow_code,
        picture=picture,
    )


def foxglove_layout(log: Path, out: Path | None = None) -> dict[str, Any]:
    """Return a layout of Foxglove and Lichtblick for a log: what a file of JSON says, to import.

    Args:
        log: the trial's MCAP file.
        out: where to write that file; None = nowhere.

    Raises:
        UsageError: there is no such log.
        StoreError: the log cannot be read, or the layout not written.
    """
    from nw_eval.files.cache import atomic_path
    from nw_eval.rollout.mcap.reader import LogReader
    from nw_eval.viewing.foxglove import layout, layout_json
    from nw_eval.viewing.shown import shown_in_log

    _check_file(log)
    shown = shown_in_log(LogReader(log))
    if out is not None:
        with atomic_path(out) as temporary:
            temporary.write_text(layout_json(shown), encoding="utf-8")
    return layout(shown)


def rerun_layout(log: Path, out: Path) -> Path:
    """Write a layout of Rerun for a log that `rerun mcap convert` has converted; return its path.

    Args:
        log: the trial's MCAP file.
        out: a path that ends with `.rbl`.

    Raises:
        PrerequisiteError: the extra `rerun` is not installed.
        UsageError: there is no such log, or `out` ends otherwise.
        StoreError: the log cannot be read, or the layout not written.
    """
    from nw_eval.viewing.recording.layout import write_layout

    _check_file(log)
    return write_layout(log, out)


def rerun_recording(log: Path, out: Path) -> WrittenRecording:
    """Write a log as a recording of Rerun, with the place's Gaussians where the place is at hand.

    Nothing is run again, no viewer is started, and nothing goes over a network.

    Args:
        log: the trial's MCAP file.
        out: a path that ends with `.rrd`.

    Raises:
        PrerequisiteError: the extra `rerun` is not installed.
        UsageError: there is no such log, or `out` ends otherwise.
        StoreError: the log cannot be read, or the recording not written.
    """
    from nw_eval.viewing.recording.write import write_recording

    _check_file(log)
    return write_recording(log, out)


def _check_file(log: Path) -> None:
    from nw_eval.errors import UsageError

    if not log.is_file():
        raise UsageError(
            f"{log} is {'a folder' if log.is_dir() else 'no file'}",
            fix="name a trial's log, such as RUN/mcap/SCENE/TRIAL.mcap",
        )
