"""What an annotation of `Row` says about its column, what follows from it, and what is checked.

The Arrow schema, the digest, what older files may lack, the bounds of values, the table of
docs/reference/columns.md and the words in the file itself are all made from these.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Mapping
from dataclasses import KW_ONLY, dataclass, replace
from functools import cached_property, lru_cache
from types import NoneType
from typing import Any, Literal, get_args, get_origin, get_type_hints

from nw_base.clean import LONGEST, clean

Numbers = tuple[float, ...]
"""Numbers that a file keeps in single precision; a row has them rounded to it."""

Settings = tuple[tuple[str, float], ...]
"""Numbers by name, each name once."""

_TYPES: Mapping[Any, type | tuple[type, ...]] = {
    bool: bool,
    int: int,
    float: (float, int),
    float | None: (float, int, NoneType),
    Numbers: tuple,
    Settings: tuple,
}


@dataclass(frozen=True)
class Column:
    """One column of trials.parquet, beside the type of its field.

    Attributes:
        about: what it holds, in words.
        measured: whether it may differ between two runs of the same trial. No digest has it.
        of_the_plan: whether it repeats what the suite says. The robot is part of each trial's
            seed, the tier of the gate alone, so no digest has these either.
        added: whether it came after files had been published: in those it has the field's
            default, with which it is in no digest, so that old digests stay.
        repeats: whether many rows share a text, of which a file then keeps one.
        bits: of a whole number, which is not negative: 31, 63 or 64. One of 64 is text in files.
        kind: the field's Python type, and
        default: what it is where nothing is said; `columns_of` finds both.
    """

    about: str
    _: KW_ONLY
    measured: bool = False
    of_the_plan: bool = False
    added: bool = False
    repeats: bool = False
    bits: int = 31
    kind: Any = str
    default: Any = None

    @cached_property
    def words(self) -> tuple[str, ...]:
        """The words that a value must be one of; none where any text or number will do."""
        return _words(self.kind)

    @cached_property
    def types(self) -> type | tuple[type, ...]:
        """The Python types of values; a whole number is a number too."""
        return _TYPES.get(self.kind, str)

    @cached_property
    def exact(self) -> frozenset[type]:
        """Types of which every value is one: a bool is no number here, though Python says so."""
        return frozenset(self.types if isinstance(self.types, tuple) else (self.types,))

    @cached_property
    def is_list(self) -> bool:
        """Whether a value is several."""
        return self.types is tuple

    @cached_property
    def is_real(self) -> bool:
        """Whether a value is a real number, or may be one."""
        return self.kind in {float, float | None}

    @cached_property
    def nullable(self) -> bool:
        """Whether there may be no value."""
        return NoneType in get_args(self.kind)

    def of_plain(self, value: Any) -> Any:
        """Return a value as a row has it; JSON and Arrow have lists in place of tuples."""
        if not self.is_list:
            return value
        if not value:
            return ()
        if self.kind == Settings:
            return tuple((str(name), float(number)) for name, number in value)
        return tuple(value)


class NamedColumns(dict[str, Column]):
    """Columns by name, in the order of the file; and by what their values are, to check many."""

    @cached_property
    def texts(self) -> tuple[str, ...]:
        """Names of those that hold text."""
        return tuple(name for name, column in self.items() if column.types is str)

    @cached_property
    def wholes(self) -> tuple[tuple[str, int], ...]:
        """Those that hold whole numbers, each with the first number that is too large."""
        return tuple((name, 2**column.bits) for name, column in self.items() if column.kind is int)

    @cached_property
    def reals(self) -> tuple[str, ...]:
        """Names of those that hold one real number, or may."""
        return tuple(name for name, column in self.items() if column.is_real)

    @cached_property
    def lists(self) -> tuple[tuple[str, Column], ...]:
        """Those that hold several."""
        return tuple((name, column) for name, column in self.items() if column.is_list)


def columns_of(row: type) -> NamedColumns:
    """Return the columns of a dataclass each of whose fields is annotated with one.

    Raises:
        TypeError: a field has no column, or a column that came later has no default.
    """
    columns = NamedColumns()
    for name, hint in get_type_hints(row, include_extras=True).items():
        kind, *says = get_args(hint) or (hint,)
        if not (says and isinstance(says[0], Column)):
            raise TypeError(f"{name} of {row.__name__} does not describe its column")
        if says[0].added and not hasattr(row, name):
            raise TypeError(f"{name} of {row.__name__} was added later and needs a default")
        columns[name] = replace(says[0], kind=kind, default=getattr(row, name, None))
    return columns


def _words(kind: Any) -> tuple[str, ...]:
    if get_origin(kind) is Literal:
        return get_args(kind)
    return tuple(word for part in get_args(kind) for word in _words(part))


_MARK = 60  # characters at most with which `clean` says what it cut
_WORD = 100  # characters of what is likely to come again


def mistyped(values: Mapping[str, Any], columns: Mapping[str, Column]) -> str | None:
    """Return which column holds a value of the wrong type, or an unknown word, or None."""
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
    # What `clean` has left once stays, cut or not.
    kept: dict[str, Any] = {
        name: _harmless_word(text) if len(text := values[name]) <= _WORD else _cleaned(text)
        for name in columns.texts
    }
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
