"""Writes a journal: what is appended is on disk before anybody is told of it."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import IO, Self

from nw_eval.errors import IncomparableError, StoreError
from nw_eval.files.cache import atomic_path, open_own, sync_folder
from nw_eval.results.journal.header import JournalHeader
from nw_eval.results.journal.read import JournalContents, has_begun, later, read_journal
from nw_eval.results.row import Row, RowTexts, texts_of
from nw_eval.results.seal import seal


class Journal:
    """The journal of a run that is going on. A context manager; one process may hold it."""

    def __init__(self, path: Path, handle: IO[bytes], rows: Mapping[str, Row]) -> None:
        self.path = path
        self.dropped: str | None = None
        self._handle = handle
        self._rows = dict(rows)
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
        journal = cls(path, handle, {})
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
            journal = cls(path, handle, {})
            journal._lock()
            contents = read_journal(path)
            journal._take_up(contents, header)
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
        self._write(texts.records() for texts in texts_of(rows))
        self._rows |= kept

    def close(self) -> None:
        """Release the file. Closing twice does no harm."""
        self._handle.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _write(self, portions: Iterable[Iterable[str]]) -> None:
        """Write the lines of records, all of them or none."""
        if self._handle.closed:
            raise StoreError(f"journal {self.path} is closed", fix="append within its `with` block")
        before, last_sum = self._handle.tell(), self._last_sum
        try:
            for records in portions:
                lines, last_sum = _sealed(records, last_sum)
                written = 0
                while written < len(lines):
                    written += self._handle.write(lines[written:])
            os.fsync(self._handle.fileno())
        except BaseException as error:
            # Half a line helps nobody; take it back so that what is there stays whole.
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
        self._write([[header.record()]])

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
            self._write([[header.widened(known).record()]])

    def _lock(self) -> None:
        import fcntl  # Not on Windows, where the judgement wing still runs.

        try:
            fcntl.flock(self._handle.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self._handle.close()
            raise StoreError(
                f"{self.path} is held by another nw-eval process", fix="wait for it or stop it"
            ) from None


def write_journal(path: Path, header: JournalHeader, portions: Iterable[RowTexts]) -> None:
    """Write the journal of a run that has ended elsewhere: all of it, or nothing.

    Args:
        path: where to.
        header: its first line.
        portions: of rows, one of each trial, in the order of the lines.

    Raises:
        StoreError: it cannot be written.
    """
    records = chain([[header.record()]], (texts.records() for texts in portions))
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        last_sum = ""
        for some in records:
            lines, last_sum = _sealed(some, last_sum)
            stream.write(lines)


def _sealed(records: Iterable[str], last_sum: str) -> tuple[bytes, str]:
    """Return the lines of records, and the last one's sum; each covers that of the line before."""
    lines: list[str] = []
    for record in records:
        line, last_sum = seal(record, last_sum)
        lines.append(line)
    return "".join(lines).encode(), last_sum


def _unwritable(path: Path, error: OSError) -> StoreError:
    return StoreError(
        f"cannot write {path}: {error.strerror or error}",
        fix="free disk space or choose another folder with --out; finished trials are kept",
    )
