"""Reads a journal: every line, if its sum is that of the line and of all before it."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from pydantic_core import from_json

from nw_eval.clean import clean
from nw_eval.errors import StoreError
from nw_eval.results.journal.header import VERSION, JournalHeader, header_of
from nw_eval.results.row import Row, from_dicts
from nw_eval.results.seal import sum_of, unseal

_MOST = 256 * 2**20
"""Bytes of a journal that is read: some 200,000 trials."""
_LONGEST_LINE = 4 * 2**20  # bytes; a row has about a thousand
_AT_ONCE = 500  # lines that are parsed together
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
        with path.open("rb") as stream:
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
        with path.open("rb") as stream:
            return _read(path, stream)
    except OSError as error:
        raise StoreError(f"cannot read {path}: {error.strerror}", fix="check its rights") from error


def last_sum(path: Path) -> str:
    """Return the sum of a journal's last line; empty if there is no such line."""
    try:
        with path.open("rb") as stream:
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
    lines: list[bytes] = []  # Without their sums.
    dropped: str | None = None
    good, last_sum = 0, ""
    for number, line in enumerate(iter(lambda: stream.readline(_LONGEST_LINE), b""), start=1):
        if not line.endswith(b"\n") and len(line) < _LONGEST_LINE:
            dropped = f"{path}:{number}: dropped a line that was cut off after {len(line)} bytes"
            break  # Only the last line can lack its end.
        try:
            body, last_sum = _unsealed(line, last_sum)
        except _DAMAGED as error:
            raise _damaged(path, number, error) from None
        lines.append(body)
        good += len(line)
    header, found = _parsed(path, lines)
    rows: dict[str, Row] = {}
    for row in found:
        rows[row.trial_id] = later(rows.get(row.trial_id), row, path)
    return JournalContents(
        header=header,
        rows=tuple(rows.values()),
        dropped=dropped,
        good_bytes=good,
        last_sum=last_sum,
    )


def _parsed(path: Path, lines: Sequence[bytes]) -> tuple[JournalHeader, list[Row]]:
    """Return the last header and all rows of a journal's lines."""
    header: JournalHeader | None = None
    rows: list[Row] = []
    for first in range(0, len(lines), _AT_ONCE):
        some = lines[first : first + _AT_ONCE]
        try:
            headers, found = _records(some)
        except _DAMAGED:
            headers, found = _one_by_one(path, some, first + 1)
        header = headers[-1] if headers else header
        rows += found
    if header is None:
        raise StoreError(f"{path} is empty", fix="start the run again; nothing of it is lost")
    return header, rows


def _records(
    lines: Sequence[bytes], parse: Callable[[bytes], Any] = from_json
) -> tuple[list[JournalHeader], list[Row]]:
    """Return the headers and rows of lines, which are read twice as fast together."""
    records = parse(b"[" + b",".join(lines) + b"]")
    if len(records) != len(lines):
        raise ValueError("a line is not one record")
    rows = from_dicts([record["row"] for record in records if "row" in record])
    return [header_of(record) for record in records if "row" not in record], rows


def _one_by_one(
    path: Path, lines: Sequence[bytes], first: int
) -> tuple[list[JournalHeader], list[Row]]:
    """Return the headers and rows of lines, and say which of them is damaged."""
    found: tuple[list[JournalHeader], list[Row]] = ([], [])
    for number, line in enumerate(lines, start=first):
        try:
            headers, rows = _records([line], json.loads)
        except _DAMAGED as error:
            raise _damaged(path, number, error) from None
        found[0].extend(headers)
        found[1].extend(rows)
    return found


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
