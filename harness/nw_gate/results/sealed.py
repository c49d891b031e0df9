"""One table in one Parquet file, with a checksum over all of the file's bytes in its metadata.

The sum is looked at before anything is parsed: a file that was damaged anywhere is an error, never
other results, and never meets Arrow, which is not made for damage. What a whole file says of its
size is bounded before it is unpacked.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from hashlib import sha256
from mmap import mmap
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from nw_base.files.cache import atomic_path

_MOST_COLUMNS = 200

_SUM, _UNKNOWN = "nw.sum", "0" * 64
_SUM_PLACE = re.compile(rb"nw\.sum\x18\x40([0-9a-f]{64})")
"""The sum as Thrift's compact protocol writes it: the key, then a string (8) of 64 (0x40) bytes."""


def write_table(path: Path, table: pa.Table, metadata: Mapping[str, str]) -> None:
    """Write a table with `nw.<key>` metadata; equal ones give equal bytes with one Arrow.

    Args:
        path: appears whole or not at all; an older file is replaced.
        table: what metadata its schema has are replaced.
        metadata: plain text by key without the prefix, such as `suite_digest`.

    Raises:
        StoreError: the file cannot be written.
    """
    write_tables(path, [table], metadata)


def write_tables(path: Path, tables: Iterable[pa.Table], metadata: Mapping[str, str]) -> None:
    """Write tables of one schema, one or more, as the row groups of one; as `write_table`.

    Raises:
        StoreError: the file cannot be written.
    """
    with atomic_path(path) as temporary, ExitStack() as stack:
        writer = None
        for table in tables:
            labelled = table.replace_schema_metadata(labels(metadata))
            if writer is None:
                # Fixed options, so that equal rows give equal bytes with one library version.
                opened = pq.ParquetWriter(
                    temporary, labelled.schema, compression="zstd", version="2.6"
                )
                writer = stack.enter_context(opened)
            writer.write_table(labelled)
        stack.close()
        with (
            temporary.open("r+b") as stream,
            mmap(stream.fileno(), 0) as data,
        ):
            start, end = _place(data)
            data[start:end] = _sum(data, start, end)


def labels(metadata: Mapping[str, str]) -> dict[str, str]:
    """Return metadata as a file has them, and room for its sum."""
    return {**{f"nw.{key}": value for key, value in sorted(metadata.items())}, _SUM: _UNKNOWN}


def sealed(data: bytes) -> bytes:
    """Return a file's bytes with their sum at its place in the metadata.

    Raises:
        ValueError: the file has no place for it, or several.
    """
    start, end = _place(data)
    return data[:start] + _sum(data, start, end) + data[end:]


def is_foreign(data: bytes) -> bool:
    """Say whether bytes are a Parquet file without any sum: somebody else's, or an old one."""
    return data[:4] == data[-4:] == b"PAR1" and _SUM.encode() not in data


def table_of(data: bytes, *, most_rows: int, most_bytes: int) -> pa.Table:
    """Return what a file's bytes hold; arguments and errors as `file_of`."""
    return file_of(data, most_rows=most_rows, most_bytes=most_bytes).read(use_threads=False)


def file_of(data: bytes, *, most_rows: int, most_bytes: int) -> pq.ParquetFile:
    """Return a file from its bytes, if they are whole and no larger than they may be.

    Args:
        data: all bytes of the file.
        most_rows: of the table.
        most_bytes: of any of its columns, unpacked.

    Raises:
        ValueError: its sum is that of other bytes, or it is too large.
        pa.ArrowException, OSError: Arrow cannot read it.
    """
    file = pq.ParquetFile(
        pa.BufferReader(_whole(data)),
        thrift_string_size_limit=2**24,
        thrift_container_size_limit=2**16,
    )
    footer = file.metadata
    if not 0 <= footer.num_rows <= most_rows or footer.num_columns > _MOST_COLUMNS:
        raise ValueError(f"{footer.num_rows} rows of {footer.num_columns} columns")
    groups = [footer.row_group(index) for index in range(footer.num_row_groups)]
    if sum(group.num_rows for group in groups) != footer.num_rows:
        raise ValueError("the row counts of its parts do not add up to its total")
    columns = [group.column(index) for group in groups for index in range(group.num_columns)]
    if not all(0 <= column.total_uncompressed_size <= most_bytes for column in columns):
        raise ValueError(f"a column has over {most_bytes // 2**20} MiB")
    return file


def metadata_of(schema: pa.Schema) -> dict[str, str]:
    """Return the metadata that `write_table` was given."""
    raw: Mapping[bytes, bytes] = schema.metadata or {}
    return {
        key.decode().removeprefix("nw."): value.decode()
        for key, value in raw.items()
        if key.startswith(b"nw.") and key != _SUM.encode()
    }


def _whole(data: bytes) -> bytes:
    """Return a file's bytes if they are what its sum says.

    Raises:
        ValueError: they are not.
    """
    start, end = _place(data)
    if data[start:end] != _sum(data, start, end):
        raise ValueError("its checksum is that of other bytes")
    return data


def _place(data: bytes | mmap) -> tuple[int, int]:
    """Return where the digits of the sum stand."""
    places = [match.span(1) for match in _SUM_PLACE.finditer(data)]
    if len(places) != 1:
        raise ValueError("its checksum is missing")
    return places[0]


def _sum(data: bytes | mmap, start: int, end: int) -> bytes:
    """Return the hex sha256 of a file in which the digits of the sum itself are zeros."""
    with memoryview(data) as view, view[:start] as before, view[end:] as after:
        content = sha256(before)
        content.update(_UNKNOWN.encode())
        content.update(after)
    return content.hexdigest().encode()
