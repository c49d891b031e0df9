"""What an annotation of `Row` says about its column, and what follows from it.

The Arrow schema, the digest, what older files may lack, the bounds of values, the table of
docs/results.md and the words in the file itself are all made from these.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, replace
from functools import cached_property
from types import NoneType
from typing import Any, Literal, get_args, get_origin, get_type_hints

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
        bits: of a whole number, which is not negative: 31, 63 or 64.
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

    def in_digest(self, value: Any) -> bool:
        """Whether a row's digest covers its value of this column."""
        if self.measured or self.of_the_plan:
            return False
        return not self.added or value != self.default

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
            raise TypeError(f"{name} of {row.__name__} says nothing about its column")
        if says[0].added and not hasattr(row, name):
            raise TypeError(f"{name} of {row.__name__} came later, and needs a default")
        columns[name] = replace(says[0], kind=kind, default=getattr(row, name, None))
    return columns


def _words(kind: Any) -> tuple[str, ...]:
    if get_origin(kind) is Literal:
        return get_args(kind)
    return tuple(word for part in get_args(kind) for word in _words(part))
