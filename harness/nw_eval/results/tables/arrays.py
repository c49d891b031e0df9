"""Arrow's arrays from plain values, laid out here: https://arrow.apache.org/docs/format/Columnar.html.

Arrow's own `array`, on which all its other ways stand, imports pandas wherever that is
installed, to see whether it was given something of it: longer than to write ten thousand rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate, chain
from typing import Any

import numpy as np
import pyarrow as pa


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
