"""A trial's log: run again and compared bit for bit, or shown by other programs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from nw_eval.api.paths import as_path

if TYPE_CHECKING:
    from collections.abc import Sequence
    from os import PathLike

    from nw_eval.viewing.recording.track import WrittenRecording
    from nw_sim.rollout.replaying.reports import ReplayReport, TakeoverReport
    from nw_sim.rollout.replaying.rescored import LogScores


def replay(
    log: str | PathLike[str],
    *,
    policy: str | None = None,
    checkpoint: str | PathLike[str] | None = None,
    start: float = 0.0,
    picture: str | PathLike[str] | None = None,
    video: str | PathLike[str] | None = None,
    allow_code: bool = False,
) -> ReplayReport:
    """Run a recorded trial again, in a process of its own, and compare its end bit for bit.

    Args:
        log: the trial's MCAP file.
        policy: the bundle that made it, where it has moved since, or is served elsewhere.
        checkpoint: weights that were used instead of the card's.
        start: seconds; greater than 0 begins with the last recorded state at or before it.
        picture: where to draw the trial's contact sheet, a PNG; None = nowhere.
        video: where to film what is run, an MP4; None = nowhere.
        allow_code: whether Python code that the card names may be imported.

    Raises:
        UsageError: there is no such file, `start` is not a time, `video` ends otherwise, or the
            scene has changed.
        PrerequisiteError: the extra `video` is not installed, and one is asked for.
        StoreError: the log cannot be read, or picture or video not written.
        PolicyError: the policy is missing or not the recorded one.
        SceneError: the scene is missing.
    """
    from nw_sim.rollout.replaying.apart import replay_apart

    log = _found(as_path(log))
    checkpoint = as_path(checkpoint)
    picture = as_path(picture)
    video = as_path(video)
    _check_video(video)
    return replay_apart(
        log,
        policy=policy,
        checkpoint=checkpoint,
        start=start,
        allow_code=allow_code,
        picture=picture,
        video=video,
    )


def take_over(
    log: str | PathLike[str],
    *,
    start: float,
    policy: str | None = None,
    checkpoint: str | PathLike[str] | None = None,
    out: str | PathLike[str] | None = None,
    video: str | PathLike[str] | None = None,
    allow_code: bool = False,
) -> TakeoverReport:
    """Run a recorded trial in which another policy takes over, in a process of its own.

    Until then the trial goes its recorded way, to the bit, and the other policy looks on: what it
    remembers is what it would, had it driven so from the start. The first policy's checkpoint is
    not needed.

    Args:
        log: the trial's MCAP file.
        start: seconds from the trial's beginning at which it takes over.
        policy: the policy that takes control (default: the recorded one).
        checkpoint: weights in place of those that its card names.
        out: where the log of the new trial goes, which `replay` takes too; None = nowhere.
        video: where to film all of it, an MP4; None = nowhere.
        allow_code: whether Python code that the card names may be imported.

    Raises:
        UsageError: there is no such file, `start` is not a time in the trial, `video` ends
            otherwise, or the scene has changed.
        PrerequisiteError: the extra `video` is not installed, and one is asked for.
        StoreError: the log cannot be read, does not lead that far, or goes another way here; log or
            video cannot be written.
        PolicyError: the policy is missing, or does not fit the robot.
        SceneError: the scene is missing.
        TrialError: the policy fails while it looks on.
    """
    from nw_sim.rollout.replaying.apart import take_over_apart

    log = _found(as_path(log))
    checkpoint = as_path(checkpoint)
    out = as_path(out)
    video = as_path(video)
    _check_video(video)
    return take_over_apart(
        log,
        start=start,
        policy=policy,
        checkpoint=checkpoint,
        allow_code=allow_code,
        out=out,
        video=video,
    )


def log_scores(
    log: str | PathLike[str],
    *,
    scores: Sequence[str] = (),
    robot: str | None = None,
    topics: Sequence[str] = (),
    allow_code: bool = False,
) -> LogScores:
    """Return the scores of a log, by the code that measures trials as they run.

    The trial of a run is led along its log again, in a process of its own, and no policy is asked.
    A robot's log, MCAP or the MCAP file of a ROS 2 bag, gives the scores that its topics allow.

    Args:
        log: a trial's MCAP file, a robot's MCAP or .db3 file, also compressed, or a bag
            folder.
        scores: scores to compute (default: all, with the task's own).
        robot: the robot of the log, if it is not a run's.
        topics: for a robot's log: `joints=NAME`, `targets=NAME`, `pose=NAME` or `command=NAME`
            (default: found by message type).
        allow_code: allow scores that are Python functions of the run's suite, which the log
            contains.

    Raises:
        CodeError: such a function is asked for, and may not run.
        UsageError: there is no such file, score, robot or topic; several topics could be meant.
        StoreError: the log cannot be read.
        SceneError: the scene of the trial is missing.
    """
    from nw_base.errors import UsageError
    from nw_sim.rollout.replaying.rescored import scores_of_log

    log = as_path(log)
    chosen: dict[str, str] = {}
    for each in topics:
        source, separator, name = each.partition("=")
        if not (separator and name):
            raise UsageError(
                f"--topic {each} has another form", fix="write it as joints=/joint_states"
            )
        chosen[source] = name
    if not log.is_dir():  # The folder of a ROS 2 bag
        log = _found(log)
    return scores_of_log(log, names=scores, robot=robot, topics=chosen, allow_code=allow_code)


def foxglove_layout(
    log: str | PathLike[str], out: str | PathLike[str] | None = None
) -> dict[str, Any]:
    """Return a layout of Foxglove and Lichtblick for a log: what a file of JSON says, to import.

    Args:
        log: the trial's MCAP file.
        out: where to write that file; None = nowhere.

    Raises:
        UsageError: there is no such log.
        StoreError: the log cannot be read, or the layout not written.
    """
    from nw_base.files.cache import atomic_path, followed
    from nw_eval.viewing.shown import layout, layout_json, shown_in_log
    from nw_sim.rollout.mcap.reader import LogReader

    log, out = _found(as_path(log)), as_path(out)
    shown = shown_in_log(LogReader(log))
    if out is not None:
        with atomic_path(followed(out)) as temporary:
            temporary.write_text(layout_json(shown), encoding="utf-8")
    return layout(shown)


def rerun_layout(log: str | PathLike[str], out: str | PathLike[str]) -> Path:
    """Write a layout of Rerun for a log that `rerun mcap convert` has converted; return its path.

    Args:
        log: the trial's MCAP file.
        out: a path that ends with `.rbl`.

    Raises:
        PrerequisiteError: the extra `rerun` is not installed.
        UsageError: there is no such log, or `out` ends otherwise.
        StoreError: the log cannot be read, or the layout not written.
    """
    from nw_eval.viewing.recording.content import write_layout

    log, out = _found(as_path(log)), as_path(out)
    return write_layout(log, out)


def rerun_recording(log: str | PathLike[str], out: str | PathLike[str]) -> WrittenRecording:
    """Write a log as a recording of Rerun, with the scene's Gaussians where the scene is at hand.

    Nothing is run again, no viewer is started, and nothing goes over a network.

    Args:
        log: the trial's MCAP file.
        out: a path that ends with `.rrd`.

    Raises:
        PrerequisiteError: the extra `rerun` is not installed.
        UsageError: there is no such log, or `out` ends otherwise.
        StoreError: the log cannot be read, or the recording not written.
    """
    from nw_eval.viewing.recording.content import write_recording

    log, out = _found(as_path(log)), as_path(out)
    return write_recording(log, out)


def _check_video(video: Path | None) -> None:
    """Refuse a video that cannot be made, before anything runs."""
    from nw_base.errors import UsageError
    from nw_sim.rollout.replaying.film import video_library

    if video is None:
        return
    if video.suffix != ".mp4":
        raise UsageError(f"--video {video} is no .mp4", fix="give it that ending")
    video_library()


def _found(log: Path) -> Path:
    """Return where a log lies, which may be that of a trial that was taken over.

    Raises:
        UsageError: there is none.
    """
    from nw_base.errors import UsageError
    from nw_gate.results.log_links import taken_over_log

    path = taken_over_log(log)
    if not path.is_file():
        raise UsageError(
            f"{log} is {'a folder' if log.is_dir() else 'not a file'}",
            fix="name a trial's log, such as RUN/mcap/SCENE/TRIAL.mcap",
        )
    return path
