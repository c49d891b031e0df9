"""Rows in one Parquet file: the explicit Arrow schema, sealed as `sealed` has it.

The schema is made from what `Row` says of its fields.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any

import pyarrow as pa

from nw_base.clean import clean
from nw_base.errors import StoreError
from nw_base.files.inside import bounded_bytes
from nw_gate.results.column import Column, Numbers, Settings
from nw_gate.results.row import COLUMNS, Row, rows_of
from nw_gate.results.sealed import file_of, is_foreign, metadata_of, write_tables

_TYPES: Mapping[Any, pa.DataType] = {
    str: pa.string(),
    bool: pa.bool_(),
    float: pa.float64(),
    float | None: pa.float64(),
    Numbers: pa.list_(pa.float32()),
    Settings: pa.map_(pa.string(), pa.float64()),
}
_WHOLE = {31: pa.int32(), 63: pa.int64(), 64: pa.string()}
"""By bits. SQLite has no number of 64 bits without a sign, and JavaScript's have 53: such are text.
Files of before have numbers there, which are read as well."""
_AS_TEXT = tuple(name for name, column in COLUMNS.items() if column.bits == 64)


def _type(column: Column) -> pa.DataType:
    if column.words or column.repeats:
        return pa.dictionary(pa.int32(), pa.string())
    return _WHOLE[column.bits] if column.kind is int else _TYPES[column.kind]


SCHEMA = pa.schema(
    [
        pa.field(name, _type(column), nullable=column.nullable, metadata={"about": column.about})
        for name, column in COLUMNS.items()
    ]
)
"""The columns in the order of the file. Its metadata say what each one holds (`about`)."""


SCHEMA_VERSION = "2"
"""Raised when a column changes its meaning; new columns may be added without."""

MOST_BYTES = 256 * 2**20
"""Of a file that is read, and of any of its columns unpacked."""
_MOST_ROWS = 1_000_000
_REBUILD = "`nw-eval report` on its folder writes it again from the journal"


_GROUP = 2**16
"""Rows that lie in a file as one group; of more rows a group has `_MANY_GROUP`."""
_MANY_GROUP = 2**14
"""Rows whose values are in memory as Python's objects together: 3,000 bytes each."""


def write_rows(path: Path, rows: Iterable[Row], metadata: Mapping[str, str]) -> None:
    """Write rows, sorted by trial, with `nw.<key>` metadata in the schema.

    Args:
        path: appears whole or not at all; an older file is replaced.
        rows: in any order.
        metadata: plain text by key without the prefix, such as `suite_digest`.

    Raises:
        StoreError: the file cannot be written.
    """
    ordered = sorted(rows, key=attrgetter("trial_id", "arm"))
    size = _GROUP if len(ordered) <= _GROUP else _MANY_GROUP
    groups = (
        _table(ordered[first : first + size]) for first in range(0, max(1, len(ordered)), size)
    )
    write_tables(path, groups, {"schema_version": SCHEMA_VERSION, **metadata})


def _table(rows: Sequence[Row]) -> pa.Table:
    columns = {name: [getattr(row, name) for row in rows] for name in COLUMNS}
    for name in _AS_TEXT:
        columns[name] = list(map(str, columns[name]))
    return pa.Table.from_pydict(columns, schema=SCHEMA)


def _other_version(path: Path, version: str | None) -> StoreError:
    return StoreError(
        f"{path} has row schema {clean(version, at_most=40)}, this nw-eval reads {SCHEMA_VERSION}",
        fix="use the version of nw-eval that wrote it",
    )


def read_rows(path: Path) -> tuple[list[Row], dict[str, str]]:
    """Read rows and their metadata, keys without the `nw.` prefix.

    Columns that this version does not know are left out: later versions may add some.

    Raises:
        StoreError: the file is missing, too large, damaged, of another schema version, or no file
            of rows.
    """
    values = plain_rows(path)
    metadata = next(values)
    try:
        return [*rows_of(values, metadata.get("rows_digest"))], metadata
    except ValueError as error:
        raise _damaged(path, error) from None


def plain_rows(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the metadata of a file, and then the plain values of its rows, which are not checked.

    Raises:
        StoreError: as `read_rows`.
    """
    try:
        data = bounded_bytes(path, MOST_BYTES)
    except FileNotFoundError:
        raise StoreError(f"no rows at {path}", fix="name a run folder or its parquet") from None
    except OSError as error:
        raise StoreError(f"cannot read {path}: {error.strerror}", fix="check its rights") from error
    except ValueError as error:
        raise _damaged(path, error) from None
    if is_foreign(data):
        raise _other_version(path, None)
    try:
        file = file_of(data, most_rows=_MOST_ROWS, most_bytes=MOST_BYTES)
        metadata = metadata_of(file.schema_arrow)
        if metadata.get("schema_version") != SCHEMA_VERSION:
            raise _other_version(path, metadata.get("schema_version"))
        held = file.schema_arrow.names
        needed = [name for name, column in COLUMNS.items() if not column.added]
        if missing := [name for name in needed if name not in held]:
            raise StoreError(f"{path} lacks the columns {', '.join(missing)}", fix="run again")
        yield metadata
        for number in range(file.num_row_groups):
            yield from _plain(file.read_row_group(number, use_threads=False))
    # Arrow's exceptions are also ValueError, KeyError, TypeError, MemoryError and OSError.
    except (pa.ArrowException, OSError, ValueError, LookupError, TypeError, MemoryError) as error:
        raise _damaged(path, error) from None


def _damaged(path: Path, error: Exception) -> StoreError:
    reason = clean(error, at_most=200) or type(error).__name__
    return StoreError(f"{path} is damaged: {reason}", fix=_REBUILD)


def _plain(table: pa.Table) -> list[dict[str, Any]]:
    schema = pa.schema(
        field.with_type(pa.uint64()) if field.name in _AS_TEXT else field
        for field in SCHEMA
        if field.name in table.schema.names
    )
    return table.select(schema.names).cast(schema).to_pylist()
