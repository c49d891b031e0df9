"""What is wrong with a row: types, words and bounds."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import Any

from nw_eval.clean import LONGEST, clean
from nw_eval.results.row.column import Column, NamedColumns, Numbers, Settings

_MARK = 60  # characters at most with which `clean` says what it cut
_WORD = 100  # characters of what is likely to come again


def mistyped(values: Mapping[str, Any], columns: Mapping[str, Column]) -> str | None:
    """Return which column holds a value of the wrong type, or a word that is none, or None."""
    for name, column in columns.items():
        value = values[name]
        if type(value) not in column.exact and not _is_kin(value, column):
            return f"{name} is {clean(repr(value), at_most=60)}"
        if column.words and value not in column.words:
            return f"{name} {clean(repr(value), at_most=60)} is {_none_of(column.words)}"
    return None


def _is_kin(value: Any, column: Column) -> bool:
    """Whether a value is of a class that is made from one of the column's, such as NumPy's."""
    is_other = isinstance(value, bool) and column.types is not bool
    return not is_other and isinstance(value, column.types)


def as_kept(values: Mapping[str, Any], columns: NamedColumns) -> dict[str, Any]:
    """Return texts and lists as files keep them: harmless and short, and in single precision.

    Raises:
        struct.error, OverflowError: a list holds something that is no such number.
    """
    kept: dict[str, Any] = {name: _harmless(values[name]) for name in columns.texts}
    for name, column in columns.lists:
        if column.kind == Numbers:
            form = f"{len(values[name])}f"
            kept[name] = struct.unpack(form, struct.pack(form, *values[name]))
    return kept


def out_of_bounds(values: Mapping[str, Any], columns: NamedColumns) -> str | None:
    """Return which number no file of rows can hold, or None."""
    for name, too_large in columns.wholes:
        if not 0 <= values[name] < too_large:
            shown, bits = clean(values[name], at_most=30), columns[name].bits
            return f"{name} is {shown}, which does not fit {bits} bits without a sign"
    for name in columns.reals:
        value = values[name]
        if value is not None and not math.isfinite(value):
            return f"{name} is not finite"
    for name, column in columns.lists:
        for of, number in _numbers(name, values[name], column):
            if not math.isfinite(number):
                return f"{clean(of, at_most=60)} is not finite"
    return None


def is_harmless(text: str) -> bool:
    """Say whether `as_kept` leaves a text as it is."""
    return _harmless(text) == text


def _harmless(text: str) -> str:
    """Return a text as `clean` leaves it; what it has left once stays, cut or not."""
    return _harmless_word(text) if len(text) <= _WORD else _cleaned(text)


@lru_cache(maxsize=4096)  # Most words of a run are in every one of its rows.
def _harmless_word(text: str) -> str:
    return _cleaned(text)


def _cleaned(text: str) -> str:
    is_plain = text.isprintable() and not text.startswith("::") and "##[" not in text
    return text if is_plain and len(text) <= LONGEST + _MARK else clean(text)


def _none_of(words: tuple[str, ...]) -> str:
    return (
        f"neither {words[0]} nor {words[1]}" if len(words) == 2 else f"none of {', '.join(words)}"
    )


def _numbers(name: str, value: Any, column: Column) -> Iterable[tuple[str, float]]:
    """Return the numbers of a list, each with what it is called."""
    return value if column.kind == Settings else [(name, number) for number in value]
