"""Writes a trial's log as a recording of Rerun, a file that shows itself; and its layout alone."""

from __future__ import annotations

from collections import defaultdict
from hashlib import file_digest
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nw_eval.clean import clean
from nw_eval.errors import StoreError, UsageError
from nw_eval.files.cache import atomic_path, followed
from nw_eval.rollout.mcap.reader import LogReader
from nw_eval.rollout.replaying.logged import read_logged_trial
from nw_eval.viewing.recording.blueprint import (
    SceneScreen,
    blueprint,
    plot_of_entities,
    save_layout,
)
from nw_eval.viewing.recording.content import (
    WORLD,
    first_pose,
    picture_topics,
    picture_view,
    place_splat,
    splat_archetype,
    term_entities,
    write_pictures,
    write_place,
    write_series,
)
from nw_eval.viewing.recording.track import TIME, Track, WrittenRecording, rerun_sdk
from nw_eval.viewing.shown import shown_in_log

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from nw_eval.rollout.replaying.logged import LoggedTrial
    from nw_eval.viewing.recording.content import Messages

SUFFIX = ".rrd"
_MOST_PICTURES, _MOST_TERMS = 3, 2
_UNSHOWN = ("/nw/state", "/points/")  # states are for replays, points for viewers without meshes

_LAYOUT_SUFFIX = ".rbl"


def write_recording(log: Path, out: Path) -> WrittenRecording:
    """Write a log as Rerun's own: meshes, robot, Gaussians, pictures, and numbers by name.

    Raises:
        PrerequisiteError: Rerun is not installed.
        UsageError: `out` has another suffix than `.rrd`.
        StoreError: the log cannot be read or is damaged, or the recording not written.
    """
    rerun_sdk()
    if out.suffix.lower() != SUFFIX:
        raise UsageError(f"{out}: Rerun knows its recordings by {SUFFIX}", fix="name it so")
    logged = read_logged_trial(log)
    messages = _messages(logged)
    gaussians, no_splat = place_splat(logged)
    with atomic_path(followed(out)) as temporary:
        try:
            _write(temporary, logged, messages, gaussians)
        except (ValueError, LookupError) as error:
            reason = clean(error, at_most=200)
            raise StoreError(f"{log} is damaged: {reason}", fix="run the trial again") from error
        size = temporary.stat().st_size
    return WrittenRecording(
        file=out,
        bytes=size,
        gaussians=0 if gaussians is None else len(gaussians),
        no_splat=no_splat,
    )


def _messages(logged: LoggedTrial) -> dict[str, list[tuple[int, Any]]]:
    found: defaultdict[str, list[tuple[int, Any]]] = defaultdict(list)
    for topic, time, message in logged.log.messages():
        if not topic.startswith(_UNSHOWN):
            found[topic].append((time, message))
    return dict(found)


def _write(
    path: Path, logged: LoggedTrial, messages: dict[str, list[tuple[int, Any]]], gaussians: Any
) -> None:
    elements = logged.log.elements()
    trial = clean(logged.job.trial.id, at_most=200)
    with logged.path.open("rb") as stream:
        digest = file_digest(stream, "sha256").hexdigest()
    with Track(f"{trial}-{digest[:12]}", path, name=trial) as track:
        track.lay_out(_layout(track, messages, elements, has_splat=gaussians is not None))
        write_place(track, messages)
        if gaussians is not None:
            track.stays(track.entity(WORLD, "splat"), splat_archetype(gaussians))
        write_pictures(track, messages)
        write_series(track, messages, elements)
        for time, line in messages.get("/log", ()):
            track.at(time, "log", track.rr.TextLog(line.message, level=_level(line)))


def _layout(
    track: Track,
    messages: Messages,
    elements: Mapping[str, Sequence[str]],
    *,
    has_splat: bool,
) -> Any:
    """Return what the recording shows when it is opened."""
    start, trunk = first_pose(messages), messages["/robot/twist"][0][1].frame_id
    topics = picture_topics(messages)[:_MOST_PICTURES]
    plots = [
        plot_of_entities("Velocity, commanded and measured", ["/command", "/twist/linear"]),
        plot_of_entities("Joint angles", ["/joints/position"]),
        plot_of_entities("Joint targets", ["/policy/targets"]),
    ]
    if seen := next((t for t in messages if t.startswith("/observation/") and t in elements), None):
        names = [term.name for term in messages[seen][0][1].terms]
        entities = term_entities(track, seen, names)[:_MOST_TERMS]
        plots.append(plot_of_entities("What the policy was given", entities))
    return blueprint(
        place=SceneScreen(
            root=f"/{WORLD}",
            follows=track.entity(WORLD, "robot", trunk),
            start=start,
            # Splat and mesh lie on each other: half of either shows through.
            hides=(f"/{WORLD}/place",) if has_splat else (),
        ),
        pictures=dict(picture_view(track, messages, topic) for topic in topics),
        plots=plots,
        timeline=TIME,
    )


def _level(line: Any) -> str:
    return "ERROR" if line.level == line.ERROR else "INFO"


def write_layout(log: Path, out: Path) -> Path:
    """Write how Rerun is to show a log that it has converted itself; return `out`.

    Raises:
        PrerequisiteError: Rerun is not installed.
        UsageError: `out` has another suffix than `.rbl`.
        StoreError: the log cannot be read or is damaged, or the layout not written.
    """
    rerun_sdk()
    if out.suffix.lower() != _LAYOUT_SUFFIX:
        raise UsageError(f"{out}: Rerun knows its layouts by {_LAYOUT_SUFFIX}", fix="name it so")
    shown = shown_in_log(LogReader(log))
    with atomic_path(followed(out)) as temporary:
        save_layout(shown, temporary)
    return out
