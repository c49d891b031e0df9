"""What logs show as a page takes it, with a sentence for all that is missing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from nw_eval.api.running.evidence.chosen import clipped_trials
from nw_eval.api.running.evidence.content import ReadClip, ReadLog
from nw_eval.plural import plural
from nw_eval.reporting.html.evidence import Clip, LogEvidence, PlacePicture, PlaceView, WalkedPath
from nw_eval.results.row import Row

_NAMED = 3
"""Logs that cannot be read and are named."""
_SAME = 0.01
"""Metres: waypoints that are closer together are drawn as one."""
_FOR_PEOPLE = "/camera/ego"
"""Where logs have pictures for people, if the policy sees none."""


def composed(results: Sequence[Row], read: Mapping[str, ReadLog]) -> LogEvidence:
    """Return the evidence on trials.

    Args:
        results: all trials that came to a result.
        read: what the logs of some of them show, by trial.
    """
    rows = sorted(results, key=lambda row: row.trial_id)
    logs = [(row, read[row.trial_id]) for row in rows if row.trial_id in read]
    shown = [(row, log) for row, log in logs if not log.fault]
    places = [
        _place(scene, [log for row, log in shown if row.scene == scene])
        for scene in sorted({row.scene for row, _ in shown})
    ]
    seen = {row.trial_id: log.clip for row, log in shown if log.clip is not None}
    worst = clipped_trials([row for row in rows if row.trial_id in seen])
    clips = tuple(_clip(row, seen[row.trial_id]) for row in worst)
    remarks = (
        _left_out(rows, [row for row, _ in shown]),
        *_faults("The log of {} shows nothing: {}.", [(r, log.fault) for r, log in logs]),
        *_faults("The pictures of {} cannot be shown: {}.", [(r, log.unseen) for r, log in logs]),
        _moved(max((spread for _, spread in places), default=0.0)),
        _blind(rows, clips),
    )
    return LogEvidence(
        paths=tuple(
            WalkedPath(trial_id=row.trial_id, points=np.array(log.walked, dtype=np.float64))
            for row, log in shown
        ),
        places=tuple(place for place, _ in places),
        clips=clips,
        remarks=tuple(filter(None, remarks)),
    )


def _place(scene: str, logs: Sequence[ReadLog]) -> tuple[PlaceView, float]:
    """Return a place, and how far, in m, a trial's waypoint is from the one that is drawn."""
    trails = [log.waypoints for log in logs if len(log.waypoints) == len(logs[0].waypoints)]
    trail = np.mean(np.array(trails), axis=0)
    spread = np.linalg.norm(np.array(trails) - trail, axis=-1).max()
    place = next((log.place for log in logs if log.place is not None), None)
    picture = None
    if place is not None:
        west, south, east, north = place.box
        picture = PlacePicture(
            mime="image/webp", data=place.picture, west=west, east=east, south=south, north=north
        )
    view = PlaceView(scene=scene, waypoints=trail, reach=logs[0].reach, picture=picture)
    return view, float(spread)


def _clip(row: Row, clip: ReadClip) -> Clip:
    is_seen = row.coverage_mean is not None or clip.topic != _FOR_PEOPLE
    eyes = (
        f"what the policy saw ({clip.topic})"
        if is_seen
        else "the robot's camera, for people: this policy sees no pictures"
    )
    return Clip(
        trial_id=row.trial_id,
        mime="image/webp",
        data=clip.data,
        still=clip.still,
        width=clip.width,
        height=clip.height,
        seconds=clip.seconds,
        caption=f"On its way to waypoint {row.waypoints_reached + 1} of {row.waypoints_total}, the "
        f"last {clip.seconds:.1f} s: {eyes}.",
    )


def _left_out(rows: Sequence[Row], drawn: Sequence[Row]) -> str:
    if len(drawn) == len(rows):
        return ""
    failed = sum(not row.completed for row in rows)
    drawn_failed = sum(not row.completed for row in drawn)
    return (
        f"Walks of {len(drawn)} of {plural(len(rows), 'trial')} are drawn: of {drawn_failed} of "
        f"the {failed} that did not complete, and of {len(drawn) - drawn_failed} of the "
        f"{len(rows) - failed} that did."
    )


def _faults(sentence: str, faults: Sequence[tuple[Row, str]]) -> list[str]:
    found = [sentence.format(row.trial_id, fault) for row, fault in faults if fault]
    more = len(found) - _NAMED
    return found[:_NAMED] + ([f"So it is with {plural(more, 'more log')}."] if more > 0 else [])


def _moved(spread: float) -> str:
    if spread < _SAME:
        return ""
    return (
        "Trials of a scene have their waypoints in places of their own; drawn is the mean, from "
        f"which they are up to {100 * spread:.0f} cm away."
    )


def _blind(rows: Sequence[Row], clips: Sequence[Clip]) -> str:
    if clips or all(row.completed for row in rows):
        return ""
    return "There are no clips: the logs of the worst trials hold no pictures."
