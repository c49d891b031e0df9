"""Rows in one Parquet file: the explicit Arrow schema, sealed as `sealed` has it.

The schema is made from what `Row` says of its fields. Arrow's arrays are laid out here from plain
values, as https://arrow.apache.org/docs/format/Columnar.html has it: Arrow's own `array`, on which
all its other ways stand, imports pandas wherever that is installed, to see whether it was given
something of it: longer than to write ten thousand rows.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import accumulate, chain
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from nw_base.clean import clean
from nw_base.errors import StoreError
from nw_base.files.inside import bounded_bytes
from nw_gate.results.column import Column, Numbers, Settings
from nw_gate.results.row import COLUMNS, Results, Row, by_column, from_dicts, texts_of
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


def write_rows(
    path: Path, rows: Iterable[Row], metadata: Mapping[str, str], *, is_sorted: bool = False
) -> None:
    """Write rows, sorted by trial, with `nw.<key>` metadata in the schema.

    Args:
        path: appears whole or not at all; an older file is replaced.
        rows: in any order.
        metadata: plain text by key without the prefix, such as `suite_digest`.
        is_sorted: whether they are sorted by trial and arm already.

    Raises:
        StoreError: the file cannot be written.
    """
    ordered = list(rows)
    if not is_sorted:
        ordered.sort(key=attrgetter("trial_id", "arm"))
    size = _GROUP if len(ordered) <= _GROUP else _MANY_GROUP
    groups = (
        _table(ordered[first : first + size]) for first in range(0, max(1, len(ordered)), size)
    )
    write_tables(path, groups, {"schema_version": SCHEMA_VERSION, **metadata})


def _table(rows: Sequence[Row]) -> pa.Table:
    columns = by_column(rows)
    for name in _AS_TEXT:
        columns[name] = list(map(str, columns[name]))
    arrays = [array_of(columns.pop(field.name), field.type) for field in SCHEMA]
    return pa.Table.from_arrays(arrays, schema=SCHEMA)


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
    metadata: dict[str, str] = {}
    return list(chain.from_iterable(read_groups(path, metadata))), metadata


def read_groups(path: Path, metadata: dict[str, str] | None = None) -> Iterator[list[Row]]:
    """Yield the rows of a file, group by group; as `read_rows`.

    What is wrong with a row, or with all of them together, shows at its group or at the end.

    Args:
        path: the file.
        metadata: is filled with the file's.

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
        raise StoreError(f"{path} is damaged: {error}", fix=_REBUILD) from None
    yield from _groups_of(data, path, {} if metadata is None else metadata)


def _groups_of(data: bytes, path: Path, metadata: dict[str, str]) -> Iterator[list[Row]]:
    """Yield the rows of a file's bytes; as `read_groups`."""
    if is_foreign(data):
        raise _other_version(path, None)
    results = Results()
    try:
        file = file_of(data, most_rows=_MOST_ROWS, most_bytes=MOST_BYTES)
        metadata |= metadata_of(file.schema_arrow)
        if metadata.get("schema_version") != SCHEMA_VERSION:
            raise _other_version(path, metadata.get("schema_version"))
        held = file.schema_arrow.names
        needed = [name for name, column in COLUMNS.items() if not column.added]
        if missing := [name for name in needed if name not in held]:
            raise StoreError(f"{path} lacks the columns {', '.join(missing)}", fix="run again")
        for number in range(file.num_row_groups):
            rows = from_dicts(_plain(file.read_row_group(number, use_threads=False)))
            for texts in texts_of(rows):
                results.extend(texts)
            yield rows
    # Arrow's exceptions are also ValueError, KeyError, TypeError, MemoryError and OSError.
    except (pa.ArrowException, OSError, ValueError, LookupError, TypeError, MemoryError) as error:
        reason = clean(error, at_most=200) or type(error).__name__
        raise StoreError(f"{path} is damaged: {reason}", fix=_REBUILD) from None
    if metadata.get("rows_digest", actual := results.digest) != actual:
        raise StoreError(f"{path}: its rows are not those of its rows_digest", fix=_REBUILD)


def _plain(table: pa.Table) -> list[dict[str, Any]]:
    schema = pa.schema(
        field.with_type(pa.uint64()) if field.name in _AS_TEXT else field
        for field in SCHEMA
        if field.name in table.schema.names
    )
    return table.select(schema.names).cast(schema).to_pylist()


def array_of(values: Sequence[Any], kind: pa.DataType) -> pa.Array:
    """Return what `pa.array` does, of a type that rows have.

    Args:
        values: texts, numbers, truth values, sequences of numbers, or of pairs of text and number;
            None where a number may be missing.
        kind: the type.

    Raises:
        OverflowError, TypeError, ValueError: a value is not of that type.
    """
    if pa.types.is_dictionary(kind):
        words = {word: number for number, word in enumerate(dict.fromkeys(values))}
        numbers = array_of(list(map(words.__getitem__, values)), kind.index_type)
        return pa.DictionaryArray.from_arrays(numbers, array_of(list(words), kind.value_type))
    if pa.types.is_string(kind):
        data = "".join(values).encode()
        lengths = values if data.isascii() else [value.encode() for value in values]
        return _laid_out(kind, values, _ends(lengths), data)
    if pa.types.is_map(kind):
        pairs = list(chain.from_iterable(values))
        keys = array_of([name for name, _ in pairs], kind.key_type)
        items = array_of([number for _, number in pairs], kind.item_type)
        return pa.MapArray.from_arrays(_offsets(values), keys, items)
    if pa.types.is_list(kind):
        parts = array_of(list(chain.from_iterable(values)), kind.value_type)
        return pa.ListArray.from_arrays(_offsets(values), parts)
    if pa.types.is_boolean(kind):
        return _laid_out(kind, values, _bits(values))
    if None not in values:
        return _laid_out(kind, values, np.array(values, _number(kind)))
    known = [value is not None for value in values]
    numbers = np.array([0 if value is None else value for value in values], _number(kind))
    return _laid_out(kind, values, numbers, known=pa.py_buffer(_bits(known)))


def _laid_out(
    kind: pa.DataType, values: Sequence[Any], *content: Any, known: Any = None
) -> pa.Array:
    """Return an array of what lies in memory as Arrow wants it.

    Args:
        kind: of the array.
        values: so many it has.
        content: its buffers.
        known: bits that say which values there are; None = all.
    """
    return pa.Array.from_buffers(kind, len(values), [known, *map(pa.py_buffer, content)])


def _number(kind: pa.DataType) -> str:
    """Return NumPy's name of a type of numbers."""
    is_whole = not pa.types.is_floating(kind)
    family = ("u" if pa.types.is_unsigned_integer(kind) else "i") if is_whole else "f"
    return f"<{family}{kind.bit_width // 8}"


def _offsets(values: Sequence[Any]) -> pa.Array:
    ends = _ends(values)
    return _laid_out(pa.int32(), ends, ends)


def _bits(values: Sequence[bool]) -> Any:
    return np.packbits(np.array(values, bool), bitorder="little")


def _ends(values: Sequence[Any]) -> Any:
    """Return where each of some sequences begins when they are joined, and where the last ends."""
    return np.fromiter(accumulate(map(len, values), initial=0), "<i4", len(values) + 1)
