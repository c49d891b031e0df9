"""What a run's logs show of its trials: where they walked, in which place, and what they saw."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from nw_eval.api.running.evidence.apart import WantedLog, read_apart
from nw_eval.api.running.evidence.chosen import MOST_CLIPS, clipped_trials, drawn_trials
from nw_eval.api.running.evidence.compose import composed
from nw_eval.api.running.evidence.content import ReadLog
from nw_eval.api.running.evidence.kept import KeptEvidence
from nw_eval.files.inside import OutsideError, inside, what_is
from nw_eval.reporting.html.evidence import CLIP_BYTES, PICTURE_BYTES, LogEvidence
from nw_eval.results.row import Row
from nw_eval.results.run_folder import RunFolder

_MOST_READ = 256 * 2**20
"""Bytes of all logs that are read; those of 160 trials have 70 to 110 MB."""
_LARGEST_PICTURE = 40_000
"""Bytes of one place's; the built-in places take some hundred, scans more."""


def gather_evidence(
    folder: RunFolder, rows: Iterable[Row], kept: KeptEvidence | None = None
) -> LogEvidence:
    """Return what logs show; what cannot be read costs its part, and the remarks say so.

    Args:
        folder: of the run.
        rows: its trials, in any order. Errors are not drawn: how far they came is no result.
        kept: what the same logs have shown before, and where to keep it; None = they are read.
    """
    results = [row for row in rows if row.status == "ok"]
    logs = _logs(folder, results)
    present = [row for row in results if row.trial_id in logs]
    clips = {row.trial_id for row in clipped_trials(present)}
    drawn = {logs[row.trial_id]: row for row in _within(drawn_trials(present), logs)}
    scenes = len({row.scene for row in drawn.values()})
    wanted = [
        WantedLog(path=path, scene=row.scene, clip=row.trial_id in clips)
        for path, row in drawn.items()
    ]
    room = {
        "picture": min(_LARGEST_PICTURE, PICTURE_BYTES // max(1, scenes)),
        "clip": CLIP_BYTES // MOST_CLIPS,
    }
    read = _read(wanted, folder, room, kept)
    return composed(results, {drawn[log.path].trial_id: content for log, content in read.items()})


def _read(
    wanted: Sequence[WantedLog],
    folder: RunFolder,
    room: dict[str, int],
    kept: KeptEvidence | None,
) -> dict[WantedLog, ReadLog]:
    """Return what each log shows: as the same logs have before, if that is kept."""
    key = "" if kept is None else kept.key(wanted, room)
    known = None if kept is None else kept.find(key)
    if known is not None and len(known) == len(wanted):
        return dict(zip(wanted, known, strict=True))
    read = dict(read_apart(wanted, folder.path, room))
    if kept is not None:
        kept.keep(key, [read[log] for log in wanted])
    return read


def _logs(folder: RunFolder, rows: Iterable[Row]) -> dict[str, Path]:
    """Return where logs lie, by trial, as far as there are any in the folder."""
    found: dict[str, Path] = {}
    for row in rows:
        if not row.mcap_path:
            continue
        try:
            path = inside(folder.path, row.mcap_path)
        except OutsideError:  # A stranger's row says so.
            continue
        if what_is(path) == "file":
            found[row.trial_id] = path
    return found


def _within(rows: Sequence[Row], logs: Mapping[str, Path]) -> list[Row]:
    """Return the first rows, as many as have logs that are not too much to read."""
    found: list[Row] = []
    room = _MOST_READ
    for row in rows:
        room -= _size(logs[row.trial_id])
        if room >= 0:
            found.append(row)
    return found


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:  # It is gone; whoever reads it says so.
        return 0
