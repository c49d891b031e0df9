"""The file of a ledger: a JSON line for each verdict, on disk before its gate ends.

    {"ledger": 1, "sum": ...}
    {"verdict": {...}, "sum": ...}

Each line's sum covers the line and the sum before it, as in a run's journal: a verdict that was
changed, or left out because one would rather forget it, is an error. It is no signature.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Any

from pydantic import ValidationError

from nw_eval.clean import clean
from nw_eval.errors import StoreError, UsageError
from nw_eval.files.cache import followed, open_own, sync_folder
from nw_eval.gate.ledger.entry import LedgerEntry, entry_of
from nw_eval.gate.verdict import Verdict
from nw_eval.results.provenance import BaselineInfo, RunInfo
from nw_eval.results.row import Row
from nw_eval.results.seal import seal, unseal

_VERSION = 1
_MOST = 256 * 2**20  # bytes of a ledger: some 100,000 verdicts
_LONGEST_LINE = 2**20  # bytes
_TRIES = 5
_MEND = "restore it from a copy, or begin another one"


@dataclass(frozen=True, kw_only=True)
class LedgerContents:
    """What a ledger holds."""

    entries: tuple[LedgerEntry, ...]
    dropped: str | None = None
    """A sentence about a torn last line."""
    good_bytes: int = 0
    """Length of the file up to the last whole line."""
    last_sum: str = ""
    """Of that line, which the next one's covers."""


def append_verdict(
    path: Path,
    verdict: Verdict,
    run: RunInfo,
    rows: Sequence[Row],
    *,
    bank: BaselineInfo | None = None,
) -> LedgerEntry:
    """Add a verdict that was just given to a ledger.

    Args:
        path: of the ledger, which is begun if there is none.
        verdict: that was given.
        run: what it is on.
        rows: that it rests on.
        bank: that the run was compared with; the one that it was begun against if None.

    Raises:
        StoreError: the ledger is damaged, or cannot be written.
    """
    entry = entry_of(verdict, run, rows, time=datetime.now(tz=UTC), bank=bank)
    append_entry(path, entry)
    return entry


def append_entry(path: Path, entry: LedgerEntry) -> None:
    """Add a verdict to a ledger, which is begun if there is none, and wait until it is on disk.

    Two gates that end at once both get their line. A line that was torn by a kill is cut off. On a
    network share whose locks are of one machine alone another one may write over the line at the
    same moment: it is read again, and added once more where it is gone.

    Raises:
        StoreError: the ledger is damaged, cannot be written, or keeps being written over.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        target = _followed(path)
        for _ in range(_TRIES):
            at, line = _append(target, entry)
            with target.open("rb") as handle:
                handle.seek(at)
                if handle.read(len(line)) == line:
                    break
        else:
            raise StoreError(
                f"{path} was written over {_TRIES} times while a verdict was added",
                fix="keep it where file locks hold between machines, or one ledger a machine",
            )
    except OSError as error:
        raise StoreError(
            f"cannot write {path}: {error.strerror or error}",
            fix="free disk space, or name another file with --ledger",
        ) from error
    sync_folder(path.parent)


def _followed(path: Path) -> Path:
    """Return the file that a ledger's path leads to.

    Raises:
        StoreError: it leads to no file: the verdict is there already, and this is no usage error.
    """
    try:
        return followed(path)
    except UsageError as error:
        raise StoreError(error.message, fix="name another file with --ledger") from error


def _append(path: Path, entry: LedgerEntry) -> tuple[int, bytes]:
    """Write the line of an entry behind all others; return its place in the file, and it."""
    with os.fdopen(open_own(path, os.O_RDWR | os.O_CREAT), "r+b", buffering=0) as handle:
        _lock(handle)
        contents = _read(path, handle)
        handle.truncate(contents.good_bytes)
        handle.seek(contents.good_bytes)
        line = _lines(entry, contents.last_sum)
        _write(handle, line)
    return contents.good_bytes, line


def read_ledger(path: Path) -> LedgerContents:
    """Read a ledger.

    Raises:
        StoreError: it is missing, too large, or damaged before its last line.
    """
    try:
        if not path.is_file():
            raise StoreError(f"no ledger at {path}", fix="`nw-eval gate --ledger` begins one")
        with path.open("rb") as handle:
            return _read(path, handle)
    except OSError as error:
        raise StoreError(f"cannot read {path}: {error.strerror}", fix="check its rights") from error


def _lines(entry: LedgerEntry, last_sum: str) -> bytes:
    """Return the line of an entry; in an empty file, with the first line before it."""
    records: Sequence[dict[str, Any]] = [{"verdict": entry.model_dump(mode="json")}]
    if not last_sum:
        records = [{"ledger": _VERSION}, *records]
    text = ""
    for record in records:
        line, last_sum = seal(json.dumps(record, separators=(",", ":"), allow_nan=False), last_sum)
        text += line
    return text.encode()


def _write(handle: IO[bytes], data: bytes) -> None:
    before = handle.tell()
    try:
        written = 0
        while written < len(data):
            written += handle.write(data[written:])
        os.fsync(handle.fileno())
    except OSError:
        handle.truncate(before)  # Half a line helps nobody.
        raise


def _read(path: Path, stream: IO[bytes]) -> LedgerContents:
    if os.fstat(stream.fileno()).st_size > _MOST:
        raise StoreError(f"{path} has over {_MOST // 2**20} MiB", fix="check what it is")
    entries: list[LedgerEntry] = []
    good, last_sum = 0, ""
    for number, line in enumerate(iter(lambda: stream.readline(_LONGEST_LINE), b""), start=1):
        place = f"{path}:{number}"
        if not line.endswith(b"\n") and len(line) < _LONGEST_LINE:
            dropped = f"{place}: dropped a line that was cut off after {len(line)} bytes"
            return LedgerContents(
                entries=tuple(entries), dropped=dropped, good_bytes=good, last_sum=last_sum
            )
        try:
            body, last_sum = unseal(line, last_sum)
            record = json.loads(body)
            if number == 1:
                _check_version(record, path)
            else:
                entries.append(LedgerEntry.model_validate(record["verdict"]))
        except ValidationError as error:
            first = error.errors()[0]
            fault = f"{'.'.join(map(str, first['loc']))}: {first['msg'].lower()}"
            raise StoreError(f"{place}: {clean(fault, at_most=200)}", fix=_MEND) from None
        except (ValueError, TypeError, LookupError, RecursionError) as error:
            raise StoreError(f"{place}: damaged ({clean(error)})", fix=_MEND) from None
        good += len(line)
    return LedgerContents(entries=tuple(entries), good_bytes=good, last_sum=last_sum)


def _check_version(record: dict[str, Any], path: Path) -> None:
    if "ledger" not in record:
        raise StoreError(f"{path} is no ledger", fix="name one that `nw-eval gate --ledger` began")
    if record["ledger"] != _VERSION:
        raise StoreError(
            f"{path} is a ledger of version {clean(record['ledger'], at_most=40)}, this nw-eval "
            f"reads {_VERSION}",
            fix="use the version of nw-eval that wrote it",
        )


def _lock(handle: IO[bytes]) -> None:
    """Wait for whoever is appending: they take milliseconds."""
    import fcntl  # Not on Windows, where reading still works.

    fcntl.flock(handle.fileno(), fcntl.LOCK_EX)
