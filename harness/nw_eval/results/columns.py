"""The columns of trials.parquet as Arrow has them, made from what `Row` says of its fields."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pyarrow as pa

from nw_eval.results.row import COLUMNS, Column
from nw_eval.results.row.column import Numbers, Settings

_TYPES: Mapping[Any, pa.DataType] = {
    str: pa.string(),
    bool: pa.bool_(),
    float: pa.float64(),
    float | None: pa.float64(),
    Numbers: pa.list_(pa.float32()),
    Settings: pa.map_(pa.string(), pa.float64()),
}
_WHOLE = {31: pa.int32(), 63: pa.int64(), 64: pa.uint64()}


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


def columns_table() -> str:
    """Return the columns as the Markdown table of docs/results.md."""
    lines = ["| column | type | what |", "|---|---|---|"]
    lines += [f"| `{name}` | {_shown(name)} | {column.about} |" for name, column in COLUMNS.items()]
    return "\n".join(lines) + "\n"


def _shown(name: str) -> str:
    field = SCHEMA.field(name)
    kind = str(field.type.value_type if pa.types.is_dictionary(field.type) else field.type)
    return f"{kind} or none" if field.nullable else kind
