"""Rows in one Parquet file: the explicit Arrow schema, written whole or not at all.

Its metadata hold a checksum over all of the file's bytes, which is looked at before anything is
parsed: a file that was damaged anywhere is an error, never other results, and never meets Arrow,
which is not made for damage. What a whole file says of its size is bounded before it is unpacked.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from nw_eval.clean import clean
from nw_eval.errors import StoreError
from nw_eval.files.cache import atomic_path
from nw_eval.results.bounded import bounded_bytes
from nw_eval.results.columns import SCHEMA
from nw_eval.results.row import COLUMNS, Row, from_dict, rows_digest, to_dict

SCHEMA_VERSION = "2"
"""Raised when a column changes its meaning; new columns may be added without."""

MOST_BYTES = 256 * 2**20
"""Of a file that is read, and of any of its columns unpacked."""
_MOST_ROWS = 200_000
_MOST_COLUMNS = 200
_REBUILD = "`nw-eval report` on its folder writes it again from the journal"

_SUM, _UNKNOWN = "nw.sum", "0" * 64
_SUM_PLACE = re.compile(rb"nw\.sum\x18\x40([0-9a-f]{64})")
"""The sum as Thrift's compact protocol writes it: the key, then a string (8) of 64 (0x40) bytes."""


def write_rows(path: Path, rows: Iterable[Row], metadata: Mapping[str, str]) -> None:
    """Write rows, sorted by trial, with `nw.<key>` metadata in the schema.

    Args:
        path: appears whole or not at all; an older file is replaced.
        rows: in any order.
        metadata: plain text by key without the prefix, such as `suite_digest`.

    Raises:
        StoreError: the file cannot be written.
    """
    ordered = sorted(rows, key=lambda row: (row.trial_id, row.arm))
    labels = {"schema_version": SCHEMA_VERSION, **metadata}
    named = {f"nw.{key}": value for key, value in sorted(labels.items())}
    schema = SCHEMA.with_metadata({**named, _SUM: _UNKNOWN})
    table = pa.Table.from_pylist([to_dict(row) for row in ordered], schema=schema)
    with atomic_path(path) as temporary:
        # Fixed options, so that equal rows give equal bytes with one library version.
        stream = pa.BufferOutputStream()
        pq.write_table(table, stream, compression="zstd", version="2.6")
        temporary.write_bytes(sealed(stream.getvalue().to_pybytes()))


def sealed(data: bytes) -> bytes:
    """Return a file's bytes with their sum at its place in the metadata.

    Raises:
        ValueError: the file has no place for it, or several.
    """
    start, end = _place(data)
    return data[:start] + _sum(data, start, end) + data[end:]


def _other_version(path: Path, version: str | None) -> StoreError:
    return StoreError(
        f"{path} has row schema {clean(version, at_most=40)}, this nw-eval reads {SCHEMA_VERSION}",
        fix="use the version of nw-eval that wrote it",
    )


def _whole(data: bytes) -> bytes:
    """Return a file's bytes if they are what its sum says.

    Raises:
        ValueError: they are not.
    """
    start, end = _place(data)
    if data[start:end] != _sum(data, start, end):
        raise ValueError("its checksum is that of other bytes")
    return data


def _place(data: bytes) -> tuple[int, int]:
    """Return where the digits of the sum stand."""
    places = [found.span(1) for found in _SUM_PLACE.finditer(data)]
    if len(places) != 1:
        raise ValueError("its checksum is missing")
    return places[0]


def _sum(data: bytes, start: int, end: int) -> bytes:
    """Return the hex sha256 of a file in which the digits of the sum itself are zeros."""
    content = sha256(data[:start])
    content.update(_UNKNOWN.encode())
    content.update(data[end:])
    return content.hexdigest().encode()


def read_rows(path: Path) -> tuple[list[Row], dict[str, str]]:
    """Read rows and their metadata, keys without the `nw.` prefix.

    Columns that this version does not know are left out: later versions may add some.

    Raises:
        StoreError: the file is missing, too large, damaged, of another schema version, or no file
            of rows.
    """
    try:
        return rows_of(bounded_bytes(path, MOST_BYTES), path)
    except FileNotFoundError:
        raise StoreError(f"no rows at {path}", fix="name a run folder or its parquet") from None
    except OSError as error:
        raise StoreError(f"cannot read {path}: {error.strerror}", fix="check its rights") from error
    except ValueError as error:
        raise StoreError(f"{path} is damaged: {error}", fix=_REBUILD) from None


def rows_of(data: bytes, path: Path) -> tuple[list[Row], dict[str, str]]:
    """Return the rows and metadata of a file's bytes; as `read_rows`.

    Raises:
        StoreError: as `read_rows`.
    """
    if data[:4] == data[-4:] == b"PAR1" and _SUM.encode() not in data:
        raise _other_version(path, None)  # Somebody else's, or from before there were sums.
    try:
        table = _table(_whole(data))
        metadata = _metadata(table.schema)
        if metadata.get("schema_version") != SCHEMA_VERSION:
            raise _other_version(path, metadata.get("schema_version"))
        held = table.schema.names
        needed = [name for name, column in COLUMNS.items() if not column.added]
        if missing := [name for name in needed if name not in held]:
            raise StoreError(f"{path} lacks the columns {', '.join(missing)}", fix="run again")
        rows = [from_dict(plain) for plain in _plain(table)]
    # Arrow's exceptions are also ValueError, KeyError, TypeError, MemoryError and OSError.
    except (pa.ArrowException, OSError, ValueError, LookupError, TypeError, MemoryError) as error:
        reason = clean(error, at_most=200) or type(error).__name__
        raise StoreError(f"{path} is damaged: {reason}", fix=_REBUILD) from None
    if metadata.get("rows_digest", rows_digest(rows)) != rows_digest(rows):
        raise StoreError(f"{path}: its rows are not those of its rows_digest", fix=_REBUILD)
    return rows, metadata


def _table(data: bytes) -> pa.Table:
    """Return what a file holds, if it is no larger than rows can be.

    Raises:
        ValueError: it is.
    """
    file = pq.ParquetFile(
        pa.BufferReader(data),
        thrift_string_size_limit=2**24,
        thrift_container_size_limit=2**16,
    )
    footer = file.metadata
    if not 0 <= footer.num_rows <= _MOST_ROWS or footer.num_columns > _MOST_COLUMNS:
        raise ValueError(f"{footer.num_rows} rows of {footer.num_columns} columns")
    groups = [footer.row_group(index) for index in range(footer.num_row_groups)]
    if sum(group.num_rows for group in groups) != footer.num_rows:
        raise ValueError("its parts have other numbers of rows than the whole")
    columns = [group.column(index) for group in groups for index in range(group.num_columns)]
    if not all(0 <= column.total_uncompressed_size <= MOST_BYTES for column in columns):
        raise ValueError(f"a column has over {MOST_BYTES // 2**20} MiB")
    return file.read(use_threads=False)


def _plain(table: pa.Table) -> list[dict[str, Any]]:
    schema = pa.schema([field for field in SCHEMA if field.name in table.schema.names])
    return table.select(schema.names).cast(schema).to_pylist()


def _metadata(schema: pa.Schema) -> dict[str, str]:
    raw: Mapping[bytes, bytes] = schema.metadata or {}
    return {
        key.decode().removeprefix("nw."): value.decode()
        for key, value in raw.items()
        if key.startswith(b"nw.") and key != _SUM.encode()
    }
