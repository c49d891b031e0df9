"""Rows in one Parquet file: the explicit Arrow schema, sealed as `tables.sealed` has it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa

from nw_eval.clean import clean
from nw_eval.errors import StoreError
from nw_eval.results.bounded import bounded_bytes
from nw_eval.results.columns import SCHEMA
from nw_eval.results.row import COLUMNS, Row, by_column, from_dicts, rows_digest
from nw_eval.results.tables.arrays import array_of
from nw_eval.results.tables.sealed import is_foreign, metadata_of, table_of, write_table

SCHEMA_VERSION = "2"
"""Raised when a column changes its meaning; new columns may be added without."""

MOST_BYTES = 256 * 2**20
"""Of a file that is read, and of any of its columns unpacked."""
_MOST_ROWS = 200_000
_REBUILD = "`nw-eval report` on its folder writes it again from the journal"


def write_rows(path: Path, rows: Iterable[Row], metadata: Mapping[str, str]) -> None:
    """Write rows, sorted by trial, with `nw.<key>` metadata in the schema.

    Args:
        path: appears whole or not at all; an older file is replaced.
        rows: in any order.
        metadata: plain text by key without the prefix, such as `suite_digest`.

    Raises:
        StoreError: the file cannot be written.
    """
    write_columns(path, by_column(list(rows)), metadata)


def write_columns(
    path: Path, columns: Mapping[str, Sequence[Any]], metadata: Mapping[str, str]
) -> None:
    """Write rows of which all values are known by column; as `write_rows`.

    Raises:
        StoreError: the file cannot be written.
    """
    keys = list(zip(columns["trial_id"], columns["arm"], strict=True))
    order = sorted(range(len(keys)), key=keys.__getitem__)
    arrays = [
        array_of(list(map(columns[field.name].__getitem__, order)), field.type) for field in SCHEMA
    ]
    table = pa.Table.from_arrays(arrays, schema=SCHEMA)
    write_table(path, table, {"schema_version": SCHEMA_VERSION, **metadata})


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
    if is_foreign(data):
        raise _other_version(path, None)
    try:
        table = table_of(data, most_rows=_MOST_ROWS, most_bytes=MOST_BYTES)
        metadata = metadata_of(table.schema)
        if metadata.get("schema_version") != SCHEMA_VERSION:
            raise _other_version(path, metadata.get("schema_version"))
        held = table.schema.names
        needed = [name for name, column in COLUMNS.items() if not column.added]
        if missing := [name for name in needed if name not in held]:
            raise StoreError(f"{path} lacks the columns {', '.join(missing)}", fix="run again")
        rows = from_dicts(_plain(table))
    # Arrow's exceptions are also ValueError, KeyError, TypeError, MemoryError and OSError.
    except (pa.ArrowException, OSError, ValueError, LookupError, TypeError, MemoryError) as error:
        reason = clean(error, at_most=200) or type(error).__name__
        raise StoreError(f"{path} is damaged: {reason}", fix=_REBUILD) from None
    if metadata.get("rows_digest", actual := rows_digest(rows)) != actual:
        raise StoreError(f"{path}: its rows are not those of its rows_digest", fix=_REBUILD)
    return rows, metadata


def _plain(table: pa.Table) -> list[dict[str, Any]]:
    schema = pa.schema([field for field in SCHEMA if field.name in table.schema.names])
    return table.select(schema.names).cast(schema).to_pylist()
