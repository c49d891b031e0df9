"""What a run's logs show of its trials: where they walked, in which place, and what they saw.

Of all trials those are chosen whose logs are read: all failures first, and no scene is left
without. Confined processes read them: a log that brings its reader down costs only itself. For all
that is missing the page has a sentence.

To read 160 logs takes two seconds, and a run that takes its trials over from earlier ones has their
logs, too. So what the reading processes said is kept in the user's cache, under a digest of all
that it depends on: each log's bytes and what of it was wanted, this program and its libraries. And
the policy: logs are written by processes that its checkpoint may have taken over, and what one log
makes its reader say of the others is said again of the same policy's logs alone. Nothing in a file
is believed before its seal has been compared; what is damaged, or another's, is none. The files of
most runs have a megabyte, and the oldest go first.
"""

from __future__ import annotations

import stat
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Self

import numpy as np
from pydantic import ValidationError

from nw_base.confinement import Rules
from nw_base.digest import digest_of
from nw_base.errors import NwEvalError, StoreError
from nw_base.files.cache import DamagedError, private_dir, read_sealed, sealed_path
from nw_base.plural import plural
from nw_eval.api.evidence_log import ReadClip, ReadLog, ReadLogs, read_logs
from nw_eval.reporting.html.evidence import (
    CLIP_BYTES,
    PICTURE_BYTES,
    Clip,
    LogEvidence,
    PlacePicture,
    PlaceView,
    WalkedPath,
)
from nw_eval.reporting.tables.table import WORST
from nw_eval.reporting.tables.trials import worst_trials
from nw_gate.results.evidence import log_sha256
from nw_gate.results.evidence_check import present_logs
from nw_gate.results.provenance import code_info
from nw_gate.results.row import Row
from nw_gate.results.run_folder import RunFolder
from nw_sim.rollout.confined.isolated import call_isolated

if TYPE_CHECKING:
    from nw_gate.results.provenance import RunInfo

_MOST_READ = 256 * 2**20
"""Bytes of all logs that are read; those of 160 trials have 70 to 110 MB."""
_LARGEST_PICTURE = 40_000
"""Bytes of one scene's; the built-in scenes take some hundred, scans more."""


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
    logs = present_logs(folder, results)
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


def _within(rows: Sequence[Row], logs: Mapping[str, Path]) -> list[Row]:
    """Return the first rows, as many as have logs that are not too much to read."""
    kept: list[Row] = []
    room = _MOST_READ
    for row in rows:
        room -= _size(logs[row.trial_id])
        if room >= 0:
            kept.append(row)
    return kept


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:  # It is gone; whoever reads it says so.
        return 0


MOST_PATHS = 320
"""Trials whose walks are drawn: of 160 all, and some hundred of thousands that look alike."""
MOST_CLIPS = 16


def drawn_trials(rows: Iterable[Row], most: int = MOST_PATHS) -> list[Row]:
    """Return the trials whose walks are drawn: failures first, by turns of the scenes.

    Errors of the machine are none of the policy's and are not among them.
    """
    ranked: list[tuple[bool, int, str, Row]] = []
    counts: defaultdict[tuple[str, bool], int] = defaultdict(int)
    for row in sorted(rows, key=lambda row: row.trial_id):
        if row.status == "ok":
            turn = counts[row.scene, row.completed]
            counts[row.scene, row.completed] += 1
            ranked.append((row.completed, turn, row.trial_id, row))
    return [row for *_, row in sorted(ranked, key=lambda entry: entry[:3])[:most]]


def clipped_trials(rows: Sequence[Row], most: int = MOST_CLIPS) -> list[Row]:
    """Return failures, the worst first: those that a page names, and then one of every scene."""
    failed = worst_trials(rows)
    firsts = {row.scene: row for row in reversed(failed)}
    others = [row for row in failed[WORST:] if row is firsts[row.scene]]
    return [*failed[:WORST], *others][:most]


_PROCESSOR_SECONDS = 60
"""For a process; 300 logs take 4."""
_SECONDS = 300.0
"""For all of them, on a machine that is busy with other things."""
_MOST_PROCESSES = 20
"""Nine find the one of 300 logs that ends its reader."""
_UNREAD = "the process that read it ended"


@dataclass(frozen=True, kw_only=True)
class WantedLog:
    """A log, and what of it is wanted besides its path."""

    path: Path
    scene: str
    """Of which the first log that can be read shows the scene."""
    clip: bool
    waypoint: int = 0
    """Until shortly after which its film goes; 0 = until the trial's end."""


def read_apart(
    wanted: Sequence[WantedLog], folder: Path, room: dict[str, int]
) -> list[tuple[WantedLog, ReadLog]]:
    """Return each log with what it shows, in no order.

    Args:
        wanted: logs below the folder.
        folder: the only one that can be read.
        room: bytes that one `picture` of a scene and one `clip` may have.
    """
    rules = Rules(reads=(folder.resolve(),), seconds=_PROCESSOR_SECONDS)
    pairs: list[tuple[WantedLog, ReadLog]] = []
    waiting, started, end = [list(wanted)], 0, monotonic() + _SECONDS
    while waiting:
        batch = waiting.pop()
        left = end - monotonic()
        if started == _MOST_PROCESSES or left <= 0.0:
            pairs += [(log, ReadLog(fault="reading the logs took too long")) for log in batch]
            continue
        started += 1
        logs = _read_batch(batch, rules, room, left)
        if logs is not None:
            pairs += zip(batch, logs, strict=True)
        elif len(batch) > 1:  # One of them is to blame.
            half = len(batch) // 2
            waiting += [batch[half:], batch[:half]]
        else:
            pairs.append((batch[0], ReadLog(fault=_UNREAD)))
    return pairs


def _read_batch(
    batch: Sequence[WantedLog], rules: Rules, room: dict[str, int], seconds: float
) -> tuple[ReadLog, ...] | None:
    """Return what logs show, or None if the process that read them did not come back."""
    if not batch:
        return ()
    try:
        answer = call_isolated(
            read_logs,
            subject="the logs",
            rules=rules,
            time_limit=seconds,
            wanted=[(str(log.path), log.scene) for log in batch],
            clips=[str(log.path) for log in batch if log.clip],
            room=room,
        )
        logs = ReadLogs.model_validate_json(str(answer)).logs
    except (NwEvalError, OSError, ValidationError, AssertionError):
        return None  # AssertionError: a daemon of multiprocessing may start no process.
    return logs if len(logs) == len(batch) else None


_FORMAT = 2
_LIBRARIES = ("numpy", "pillow")
"""That pictures are made with; whoever has other ones makes other bytes."""
_MOST_FILE = 2**26
"""Bytes of a file that is read."""
_MOST = 2**26
"""Bytes of all of them."""


@dataclass(frozen=True, kw_only=True)
class KeptEvidence:
    """What was kept for the runs of one policy."""

    folder: Path
    """Into which only this user can write."""
    policy: tuple[str, str]
    """Hex digests of card and checkpoint."""

    @classmethod
    def of_run(cls, run: RunInfo) -> Self | None:
        """Return what there is for a run of this machine; None if it does without the cache."""
        if run.cache is None or run.cache.off:
            return None
        try:
            folder = private_dir("evidence")
        except StoreError:  # The run has said already that nothing can be kept.
            return None
        return cls(folder=folder, policy=(run.policy.card_digest, run.policy.checkpoint_digest))

    def key(self, wanted: Sequence[WantedLog], room: Mapping[str, int]) -> str:
        """Return the hex digest of what reading logs depends on; empty if one cannot be read.

        Args:
            wanted: logs, and what of them is wanted, in order.
            room: bytes that pictures may have.
        """
        with ThreadPoolExecutor() as pool:  # Hashing holds no lock.
            sums = list(pool.map(log_sha256, [log.path for log in wanted]))
        if not all(sums):
            return ""
        makers = [code_info().digest, *map(version, _LIBRARIES)]
        logs = [
            [each, log.scene, log.clip, log.waypoint]
            for each, log in zip(sums, wanted, strict=True)
        ]
        return digest_of([_FORMAT, makers, self.policy, dict(room), logs])

    def find(self, key: str) -> tuple[ReadLog, ...] | None:
        """Return what is kept under a key, in the order of its logs; None if nothing is."""
        content = self.find_text(key)
        try:
            return None if content is None else ReadLogs.model_validate_json(content).logs
        except ValidationError:
            return None

    def find_text(self, key: str) -> bytes | None:
        """Return the text that is kept under a key; None if nothing is."""
        path = self.folder / key
        try:
            facts = path.lstat()
            if not stat.S_ISREG(facts.st_mode) or facts.st_size > _MOST_FILE:
                return None
            name, _, content = bytes(read_sealed(path)).partition(b"\n")
            path.touch()
        except (OSError, DamagedError):
            return None
        return content if name == key.encode() else None

    def keep(self, key: str, logs: Sequence[ReadLog]) -> None:
        """Keep what logs show, but not what kept one from being read: that may not last."""
        if not any(log.fault or log.unseen for log in logs):
            self.keep_text(key, ReadLogs(logs=tuple(logs)).model_dump_json())

    def keep_text(self, key: str, content: str) -> None:
        """Keep a text under a key, a hex digest; nothing under an empty one."""
        if not key or (self.folder / key).is_fifo():  # It may never be read.
            return
        with suppress(StoreError), sealed_path(self.folder / key) as path:
            path.write_text(f"{key}\n{content}", encoding="utf-8")
        self._prune()

    def _prune(self) -> None:
        """Remove the files that were not used for longest, until there is room for the rest."""
        with suppress(OSError):
            files = [(path, path.lstat()) for path in self.folder.iterdir()]
            room = _MOST
            for path, facts in sorted(files, key=lambda each: -each[1].st_mtime_ns):
                room -= facts.st_size
                if room < 0:
                    path.unlink()


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
    seen = {row.trial_id: log.clip for row, log in shown if log.clip is not None}
    worst = clipped_trials([row for row in rows if row.trial_id in seen])
    clips = tuple(_clip(row, seen[row.trial_id]) for row in worst)
    remarks = (
        *_faults("The log of {} shows nothing: {}.", [(r, log.fault) for r, log in logs]),
        *_faults("The pictures of {} cannot be shown: {}.", [(r, log.unseen) for r, log in logs]),
        _blind(rows, clips),
    )
    return LogEvidence(
        paths=tuple(
            WalkedPath(
                trial_id=row.trial_id,
                points=np.array(log.walked, dtype=np.float64),
                period=log.period,
                contacts=log.contacts,
            )
            for row, log in shown
        ),
        places=tuple(
            _place(scene, [log for row, log in shown if row.scene == scene])
            for scene in sorted({row.scene for row, _ in shown})
        ),
        clips=clips,
        remarks=tuple(filter(None, remarks)),
        of_paths=_left_out(rows, [row for row, _ in shown]),
    )


def _place(scene: str, logs: Sequence[ReadLog]) -> PlaceView:
    count = len(logs[0].waypoints)
    alike = [log.waypoints for log in logs if len(log.waypoints) == count]
    trails = np.array(alike, dtype=np.float64).reshape(len(alike), count, 2)
    trail = trails.mean(axis=0)
    spread = np.linalg.norm(trails - trail, axis=-1).max(initial=0.0)
    place = next((log.place for log in logs if log.place is not None), None)
    picture = None
    if place is not None:
        west, south, east, north = place.box
        picture = PlacePicture(
            mime="image/webp", data=place.picture, west=west, east=east, south=south, north=north
        )
    return PlaceView(
        scene=scene,
        waypoints=trail,
        reach=logs[0].reach,
        picture=picture,
        note=_moved(float(spread)),
    )


def _clip(row: Row, clip: ReadClip) -> Clip:
    is_seen = row.coverage_mean is not None or clip.topic != _FOR_PEOPLE
    eyes = (
        f"what the policy saw ({clip.topic})"
        if is_seen
        else "the robot's camera (this policy sees no pictures)"
    )
    way = ""
    if row.waypoints_total:
        way = f"On its way to waypoint {row.waypoints_reached + 1} of {row.waypoints_total}, the"
    return Clip(
        trial_id=row.trial_id,
        mime="image/webp",
        data=clip.data,
        still=clip.still,
        width=clip.width,
        height=clip.height,
        seconds=clip.seconds,
        caption=f"{way or 'The'} last {clip.seconds:.1f} s: {eyes}.",
        span=f"{way or 'The'} last {clip.seconds:.1f} s.",
        is_of_policy=is_seen,
    )


def _left_out(rows: Sequence[Row], drawn: Sequence[Row]) -> str:
    if len(drawn) == len(rows):
        return ""
    failed = sum(not row.completed for row in rows)
    drawn_failed = sum(not row.completed for row in drawn)
    return (
        f"Paths of {len(drawn)} of {plural(len(rows), 'trial')} are drawn: of {drawn_failed} of "
        f"the {failed} that did not complete, and of {len(drawn) - drawn_failed} of the "
        f"{len(rows) - failed} that did."
    )


def _faults(sentence: str, faults: Sequence[tuple[Row, str]]) -> list[str]:
    sentences = [sentence.format(row.trial_id, fault) for row, fault in faults if fault]
    more = len(sentences) - _NAMED
    return sentences[:_NAMED] + (
        [f"The same is true of {plural(more, 'more log')}."] if more > 0 else []
    )


def _moved(spread: float) -> str:
    if spread < _SAME:
        return ""
    return (
        "Waypoints differ between trials: each is drawn at its mean, from which it is up to "
        f"{100 * spread:.0f} cm away."
    )


def _blind(rows: Sequence[Row], clips: Sequence[Clip]) -> str:
    if clips or all(row.completed for row in rows):
        return ""
    return "There are no clips: the logs of the worst trials hold no pictures."
