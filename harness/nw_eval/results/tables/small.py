"""A small table as a file for git, and as plain values from a file that anybody may have made.

The process that reads it imports little besides Arrow, so that it takes a fraction of a second.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nw_eval.clean import clean
from nw_eval.errors import StoreError
from nw_eval.files.cache import atomic_path
from nw_eval.results.bounded import bounded_bytes
from nw_eval.results.tables.apart import answer, values_apart

if TYPE_CHECKING:
    import pyarrow as pa

_MOST_BYTES = 16 * 2**20  # of a file
_MOST_COLUMN = 64 * 2**20  # bytes of a column, unpacked
_MOST_LINES = 200_000


@dataclass(frozen=True, kw_only=True)
class PlainTable:
    """What a file holds, of whatever types; bytes are hex digits."""

    metadata: Mapping[str, str]
    """As `sealed.metadata_of`; empty for a table of somebody else's, of which nothing is read."""
    columns: dict[str, list[Any]]
    """All of one length."""


def write_small_table(path: Path, table: pa.Table, metadata: Mapping[str, str]) -> None:
    """As `sealed.write_table`, in half of the bytes: Arrow's own types are not told once more.

    Raises:
        StoreError: the file cannot be written.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    from nw_eval.results.tables.sealed import labels, sealed

    schema = table.schema.remove_metadata()
    # Where no value repeats, a dictionary repeats them all.
    repeating: Any = [
        field.name for field in schema if not pa.types.is_fixed_size_binary(field.type)
    ]
    with atomic_path(path) as temporary:
        stream = pa.BufferOutputStream()
        with pq.ParquetWriter(
            stream,
            schema,
            compression="zstd",
            version="2.6",
            use_dictionary=repeating,
            write_statistics=False,
            store_schema=False,
        ) as writer:
            writer.write_table(table)
            writer.add_key_value_metadata(labels(metadata))
        temporary.write_bytes(sealed(stream.getvalue().to_pybytes()))


def read_small_table(path: Path, *, fix: str) -> PlainTable:
    """Read a table in a process of its own.

    Args:
        path: the file.
        fix: what to do where it cannot be read.

    Raises:
        StoreError: it is missing, too large, damaged, or ended the process.
    """
    (content,) = values_apart(__name__, path, fix=fix)
    return PlainTable(**content)


def small_table(path: Path) -> PlainTable:
    """Read a table in this process.

    Raises:
        StoreError: as `read_small_table`.
    """
    import pyarrow as pa

    from nw_eval.results.tables.sealed import is_foreign, metadata_of, table_of

    try:
        data = bounded_bytes(path, _MOST_BYTES)
        if is_foreign(data):
            return PlainTable(metadata={}, columns={})
        table = table_of(data, most_rows=_MOST_LINES, most_bytes=_MOST_COLUMN)
        metadata = metadata_of(table.schema)
        columns = {
            name: [value.hex() if isinstance(value, bytes) else value for value in values]
            for name, values in table.to_pydict().items()
        }
    # Arrow's exceptions are also ValueError, KeyError, TypeError, MemoryError and OSError.
    except (pa.ArrowException, OSError, ValueError, LookupError, TypeError, MemoryError) as error:
        reason = clean(error, at_most=200) or type(error).__name__
        raise StoreError(f"{path} is damaged: {reason}") from None
    return PlainTable(metadata=metadata, columns=columns)


if __name__ == "__main__":
    answer(lambda path: [vars(small_table(path))])
