"""Many rows at once: a column is looked at as a whole, which takes a tenth of the time."""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Collection, Mapping, Sequence
from itertools import chain
from typing import Any

from nw_eval.clean import LONGEST
from nw_eval.results.row.check import is_harmless
from nw_eval.results.row.column import Column, NamedColumns, Numbers

_NAMES = re.compile(r"[A-Za-z0-9_./ -]*")
"""Characters of which `clean` leaves every text as it is."""


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
        return distinct.issubset(column.words) if column.words else _are_harmless(distinct)
    if column.kind is int:
        return not values or (min(values) >= 0 and max(values) < 2**column.bits)
    if column.is_real:
        return all(math.isfinite(value) for value in set(values) if value is not None)
    if not column.is_list:
        return True
    return _are_numbers(values) if column.kind == Numbers else all(map(_are_settings, set(values)))


def _are_harmless(texts: Collection[str]) -> bool:
    """Say whether texts are as `clean` leaves them: most are digests and names."""
    if max(map(len, texts), default=0) <= LONGEST and _NAMES.fullmatch("".join(texts)):
        return True
    return all(map(is_harmless, texts))


def _are_numbers(lists: Sequence[tuple[Any, ...]]) -> bool:
    """Say whether lists have finite numbers alone, of single precision."""
    numbers = tuple(chain.from_iterable(lists))
    if not set(map(type, numbers)) <= {float}:
        return False
    form = f"{len(numbers)}f"
    try:
        kept = struct.unpack(form, struct.pack(form, *numbers))
    except (struct.error, OverflowError):
        return False
    return kept == numbers and all(map(math.isfinite, numbers))


def _are_settings(values: tuple[Any, ...]) -> bool:
    """Say whether a list has names with finite numbers alone."""
    pairs = all(type(pair) is tuple and len(pair) == 2 for pair in values)
    return pairs and all(
        type(name) is str and type(number) in {int, float} and math.isfinite(number)
        for name, number in values
    )
