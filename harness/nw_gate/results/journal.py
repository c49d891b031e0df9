"""The journal of a run: one JSON line per finished trial, on disk before the next one starts.

    {"journal": 3, "suite_digest": ..., "policy_digest": ..., ..., "sum": ...}
    {"row": {...}, "sum": ...}
    {"row": {...}, "sum": ...}

A run that is killed at any moment loses the trials in flight and nothing else. A line that was torn
by the kill is dropped when the journal is read, and cut off before the next line is written. Every
line's sum covers the line and the sum before it (`seal`): a line that was changed, left out,
repeated or exchanged is an error, never another result.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import IO, Any, Self

from nw_base.clean import clean
from nw_base.errors import IncomparableError, StoreError
from nw_base.files.cache import atomic_path, open_own, sync_folder
from nw_base.files.inside import regular
from nw_gate.results.provenance import RunInfo
from nw_gate.results.row import Row, from_dict, to_dict
from nw_gate.results.seal import seal, sum_of, unseal

VERSION = 3
_ENCODE = json.JSONEncoder(separators=(",", ":"), allow_nan=False).encode


@dataclass(frozen=True, kw_only=True)
class JournalHeader:
    """What the trials of one journal have in common: a run may be resumed under the same only.

    `engine` names whatever else makes bits differ, such as `mujoco: 4.0.0` and `renderer: cpu`.
    """

    suite_digest: str
    policy_digest: str
    scene_digests: Mapping[str, str]
    engine: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of_run(cls, info: RunInfo) -> Self:
        """Return what the journal of a run begins with."""
        return cls(
            suite_digest=info.suite_digest,
            policy_digest=info.policy.card_digest,
            scene_digests={name: scene.digest for name, scene in info.scenes.items()},
            engine=info.engine,
        )

    def differences(self, other: JournalHeader) -> list[str]:
        """Return what differs, in words; scenes that only one of the two has do not count."""
        sentences: list[str] = []
        for name in ("suite_digest", "policy_digest"):
            old, new = getattr(self, name), getattr(other, name)
            if old != new:
                sentences.append(f"{name.removesuffix('_digest')} ({old[:8]}, now {new[:8]})")
        for scene in sorted(set(self.scene_digests) & set(other.scene_digests)):
            old, new = self.scene_digests[scene], other.scene_digests[scene]
            if old != new:
                sentences.append(f"scene {scene} ({old[:8]}, now {new[:8]})")
        for key in sorted(set(self.engine) | set(other.engine)):
            old, new = self.engine.get(key, "none"), other.engine.get(key, "none")
            if old != new:
                sentences.append(f"{key} ({old}, now {new})")
        return sentences

    def widened(self, known: Mapping[str, str]) -> JournalHeader:
        """Return this header with scenes that the journal knows already."""
        return replace(self, scene_digests={**known, **self.scene_digests})

    def record(self) -> str:
        """Return the line, without its sum."""
        return _ENCODE({"journal": VERSION, **asdict(self)})


def header_of(record: dict[str, Any]) -> JournalHeader:
    """Return the header that a line's JSON holds.

    Raises:
        ValueError, TypeError, KeyError, AttributeError: it is invalid, or has another version.
    """
    version = record.pop("journal")
    if version != VERSION:
        raise ValueError(f"journal version {version}, this nw-eval reads {VERSION}")
    texts = (record["suite_digest"], record["policy_digest"])
    tables = (record["scene_digests"], record["engine"])
    values = (*texts, *(text for table in tables for pair in table.items() for text in pair))
    if not all(isinstance(value, str) for value in values):
        raise ValueError("a digest or a version is not text")
    return JournalHeader(**record)


class Journal:
    """The journal of a run that is going on. A context manager; one process may hold it."""

    def __init__(self, path: Path, handle: IO[bytes]) -> None:
        self.path = path
        self.dropped: str | None = None
        self._handle = handle
        self._rows: dict[str, Row] = {}
        self._last_sum = ""

    @classmethod
    def create(cls, path: Path, header: JournalHeader) -> Self:
        """Start a journal, also where the start of an earlier one was cut off in its first line.

        Raises:
            StoreError: there is one already, or the folder cannot be written.
        """
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            handle = os.fdopen(open_own(path, os.O_RDWR | os.O_CREAT), "r+b", buffering=0)
        except OSError as error:
            raise _unwritable(path, error) from error
        journal = cls(path, handle)
        try:
            journal._lock()
            journal._begin(header)
        except BaseException:
            handle.close()
            raise
        sync_folder(path.parent)
        return journal

    @classmethod
    def resume(cls, path: Path, header: JournalHeader) -> Self:
        """Go on with a journal. `rows` are those it has; `dropped` tells of a torn line.

        Raises:
            IncomparableError: suite, policy, a scene or the engine is not what it was.
            StoreError: the journal is damaged, missing, or held by another process.
        """
        try:
            handle = os.fdopen(open_own(path, os.O_RDWR), "r+b", buffering=0)
        except FileNotFoundError:
            raise StoreError(
                f"no journal at {path}", fix="start the run without --resume"
            ) from None
        except OSError as error:
            raise _unwritable(path, error) from error
        try:
            journal = cls(path, handle)
            journal._lock()
            journal._take_up(read_journal(path), header)
        except BaseException:
            handle.close()
            raise
        return journal

    @property
    def rows(self) -> tuple[Row, ...]:
        """The latest row of every finished trial, in the order of their first finish."""
        return tuple(self._rows.values())

    def append(self, row: Row) -> None:
        """Write one finished trial and wait until it is on disk; as `extend`."""
        self.extend([row])

    def extend(self, rows: Sequence[Row]) -> None:
        """Write trials that are there together, and wait once until all of them are on disk.

        A row of a trial that ended in an error is superseded by a later one; a result never is,
        but by the same one with the log that it had lost.

        Raises:
            StoreError: the disk is full or fails, or a trial has another result already; none of
                the rows is kept.
        """
        kept: dict[str, Row] = {}
        for row in rows:
            earlier = kept.get(row.trial_id) or self._rows.get(row.trial_id)
            kept[row.trial_id] = later(earlier, row, self.path)
        self._write(map(_record, rows))
        self._rows |= kept

    def close(self) -> None:
        """Release the file. Closing twice does no harm."""
        self._handle.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _write(self, records: Iterable[str]) -> None:
        """Write the lines of records, all of them or none."""
        if self._handle.closed:
            raise StoreError(f"journal {self.path} is closed", fix="append within its `with` block")
        before, last_sum = self._handle.tell(), self._last_sum
        try:
            text = ""
            for record in records:
                line, last_sum = seal(record, last_sum)
                text += line
            lines, written = text.encode(), 0
            while written < len(lines):
                written += self._handle.write(lines[written:])
            os.fsync(self._handle.fileno())
        except BaseException as error:
            # A partial line is useless: remove it, so that the rest stays valid.
            with suppress(OSError):
                self._handle.truncate(before)
                self._handle.seek(before)
            if isinstance(error, OSError):
                raise _unwritable(self.path, error) from error
            raise
        self._last_sum = last_sum

    def _begin(self, header: JournalHeader) -> None:
        """Write the first line over whatever a torn start has left."""
        if has_begun(self.path):
            raise StoreError(f"{self.path} exists already", fix="continue with --resume")
        self._handle.truncate(0)
        self._write([header.record()])

    def _take_up(self, contents: JournalContents, header: JournalHeader) -> None:
        """Stand at the end of what is whole, with its rows, if it is of the same run."""
        if differences := contents.header.differences(header):
            raise IncomparableError(
                f"cannot resume {self.path.parent}: {', '.join(differences)} changed",
                fix="start a new run without --resume",
            )
        self._rows = {row.trial_id: row for row in contents.rows}
        self.dropped = contents.dropped
        self._last_sum = contents.last_sum
        self._handle.truncate(contents.good_bytes)
        self._handle.seek(0, os.SEEK_END)
        known = contents.header.scene_digests
        if set(header.scene_digests) - set(known):
            self._write([header.widened(known).record()])

    def _lock(self) -> None:
        import fcntl  # Not on Windows, where the judgement wing still runs.

        try:
            fcntl.flock(self._handle.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self._handle.close()
            raise StoreError(
                f"{self.path} is held by another nw-eval process", fix="wait for it or stop it"
            ) from None


def write_journal(path: Path, header: JournalHeader, rows: Iterable[Row]) -> None:
    """Write the journal of a run that has ended elsewhere: all of it, or nothing.

    Args:
        path: where to.
        header: its first line.
        rows: one of each trial, in the order of the lines.

    Raises:
        StoreError: it cannot be written.
    """
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        last_sum = ""
        for record in chain([header.record()], map(_record, rows)):
            line, last_sum = seal(record, last_sum)
            stream.write(line.encode())


def _record(row: Row) -> str:
    """Return the line of a row, without its sum."""
    return _ENCODE({"row": to_dict(row)})


def _unwritable(path: Path, error: OSError) -> StoreError:
    return StoreError(
        f"cannot write {path}: {error.strerror or error}",
        fix="free disk space or choose another folder with --out; finished trials are kept",
    )


_MOST = 4 * 2**30
"""Bytes of a journal that is read: a million trials with up to four thousand bytes each."""
_LONGEST_LINE = 4 * 2**20  # bytes; a row has about a thousand
_DAMAGED = (ValueError, TypeError, KeyError, AttributeError, RecursionError)


@dataclass(frozen=True, kw_only=True)
class JournalContents:
    """What a journal holds: one row per trial, the latest, and what had to be left out."""

    header: JournalHeader
    rows: tuple[Row, ...]
    dropped: str | None = None  # A sentence about a torn last line.
    good_bytes: int = 0  # Length of the file up to the last whole line.
    last_sum: str = ""  # Of that line, which the next one's covers.


def has_begun(path: Path) -> bool:
    """Say whether a journal has its first line, without which it holds nothing to go on with.

    Raises:
        StoreError: it cannot be read.
    """
    try:
        with regular(path).open("rb") as stream:
            return stream.readline(_LONGEST_LINE).endswith(b"\n")
    except (FileNotFoundError, NotADirectoryError):
        return False
    except OSError as error:
        raise StoreError(f"cannot read {path}: {error.strerror}", fix="check its rights") from error


def read_journal(path: Path) -> JournalContents:
    """Read a journal, whether its run has ended or not.

    Raises:
        StoreError: it is missing, too large, or damaged before its last line.
    """
    try:
        if not path.is_file():
            raise StoreError(f"no journal at {path}", fix="name the folder of a run")
        if path.stat().st_size > _MOST:
            raise StoreError(f"{path} has over {_MOST // 2**20} MiB", fix="check what it is")
        with regular(path).open("rb") as stream:
            return _read(path, stream)
    except OSError as error:
        raise StoreError(f"cannot read {path}: {error.strerror}", fix="check its rights") from error


def last_sum(path: Path) -> str:
    """Return the sum of a journal's last line; empty if there is no such line."""
    try:
        with regular(path).open("rb") as stream:
            stream.seek(max(0, path.stat().st_size - _LONGEST_LINE))
            lines = stream.read(_LONGEST_LINE).splitlines(keepends=True)
    except OSError:
        return ""
    return sum_of(lines[-1]) if lines else ""


def later(earlier: Row | None, row: Row, path: Path) -> Row:
    """Return which of two rows of one trial stands: a result stands, an error gives way.

    So does a result whose log was lost, to the same one with its log.

    Raises:
        StoreError: they are different results.
    """
    if earlier is None or earlier.status == "error":
        return row
    if row.status == "ok" and earlier.digest != row.digest:
        raise StoreError(
            f"{path}: trial {row.trial_id} has two different results "
            f"({earlier.digest[:8]} and {row.digest[:8]})",
            fix="the simulation is not deterministic here; compare their logs",
        )
    return row if row.status == "ok" and earlier.lost_its_log else earlier


def _read(path: Path, stream: IO[bytes]) -> JournalContents:
    header: JournalHeader | None = None
    rows: dict[str, Row] = {}
    dropped: str | None = None
    last_sum, good = "", 0
    for number, line in enumerate(iter(lambda: stream.readline(_LONGEST_LINE), b""), start=1):
        if not line.endswith(b"\n") and len(line) < _LONGEST_LINE:
            dropped = f"{path}:{number}: dropped a line that was cut off after {len(line)} bytes"
            break  # Only the last line can lack its end.
        try:
            body, last_sum = _unsealed(line, last_sum)
            record = json.loads(body)
            if "row" in record:
                row = from_dict(record["row"])
                rows[row.trial_id] = later(rows.get(row.trial_id), row, path)
            else:
                header = header_of(record)
        except _DAMAGED as error:
            raise _damaged(path, number, error) from None
        good += len(line)
    if header is None:
        raise StoreError(f"{path} is empty", fix="start the run again; nothing of it is lost")
    return JournalContents(
        header=header,
        rows=tuple(rows.values()),
        dropped=dropped,
        good_bytes=good,
        last_sum=last_sum,
    )


def _damaged(path: Path, number: int, error: Exception) -> StoreError:
    return StoreError(f"{path}:{number}: damaged ({clean(error)})", fix=_mend(number))


def _mend(number: int) -> str:
    if number == 1:
        return "start a new run"
    return f"keep the {number - 1} lines before it (`head -n`), and --resume runs the others again"


def _unsealed(line: bytes, last_sum: str) -> tuple[bytes, str]:
    if line.startswith(b'{"journal":1,'):
        raise ValueError(f"journal version 1, this nw-eval reads {VERSION}")
    return unseal(line, last_sum)
