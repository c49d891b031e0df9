"""Many rows at once: a column is looked at as a whole, which takes a tenth of the time."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from typing import Any

from nw_eval.results.row.check import is_harmless
from nw_eval.results.row.column import Column, NamedColumns, Numbers


def all_as_kept(table: Mapping[str, Sequence[Any]], columns: NamedColumns) -> bool:
    """Say whether no value needs a second look: all are as a file keeps them, and within bounds.

    It may say no of values that are good, such as NumPy's numbers, but never yes of others: what
    is wrong, and with which row, `mistyped`, `as_kept` and `out_of_bounds` say.

    Args:
        table: a value of each row by column.
        columns: all of them.
    """
    return all(_is_as_kept(table[name], column) for name, column in columns.items())


def _is_as_kept(values: Sequence[Any], column: Column) -> bool:
    if not set(map(type, values)) <= column.exact:
        return False
    if column.types is str:
        distinct = set(values)
        known = not column.words or distinct.issubset(column.words)
        return known and all(map(is_harmless, distinct))
    if column.kind is int:
        return not values or (min(values) >= 0 and max(values) < 2**column.bits)
    if column.is_real:
        return all(math.isfinite(value) for value in values if value is not None)
    if not column.is_list:
        return True
    return all(map(_are_numbers if column.kind == Numbers else _are_settings, values))


def _are_numbers(values: tuple[Any, ...]) -> bool:
    """Say whether a list has finite numbers alone, of single precision."""
    form = f"{len(values)}f"
    try:
        kept = struct.unpack(form, struct.pack(form, *values))
    except (struct.error, OverflowError):
        return False
    return kept == values and all(map(math.isfinite, values))


def _are_settings(values: tuple[Any, ...]) -> bool:
    """Say whether a list has names with finite numbers alone."""
    pairs = all(type(pair) is tuple and len(pair) == 2 for pair in values)
    return pairs and all(
        type(name) is str and type(number) in {int, float} and math.isfinite(number)
        for name, number in values
    )
