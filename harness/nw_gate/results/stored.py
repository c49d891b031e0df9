"""Many rows in little memory: about 300 bytes each in place of 3,000.

Portions of rows are kept by column, as arrays of numbers, bytes of digests, and words that repeat.
A row that is asked for looks its values up there, so that whoever holds a million of them holds a
million pairs of a portion and an index. Up to `FEW` rows are kept as they are: looking up takes
three times as long.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import accumulate, chain
from operator import eq
from typing import Any, Protocol, Self, cast, overload

from nw_gate.results.row import COLUMNS, Row, by_column, to_dict

FEW = 10_000
"""Rows up to which they are kept as they are."""
_PORTION = 256
"""Rows in a portion: as many positions as Python has numbers for that take no memory."""


class _Values(Protocol):
    """The values of a column in one portion."""

    def __getitem__(self, place: int, /) -> Any: ...


class _Same:
    """One value for all."""

    __slots__ = ("_value",)

    def __init__(self, value: object) -> None:
        self._value = value

    def __getitem__(self, place: int) -> object:
        return self._value


class _Words:
    """Few different values."""

    __slots__ = ("_places", "_words")

    def __init__(self, words: tuple[Any, ...], places: bytes) -> None:
        self._words, self._places = words, places

    def __getitem__(self, place: int) -> object:
        return self._words[self._places[place]]


class _Hex:
    """Digests of 32 bytes as 64 digits."""

    __slots__ = ("_bytes",)

    def __init__(self, digits: str) -> None:
        self._bytes = bytes.fromhex(digits)

    def __getitem__(self, place: int) -> str:
        return self._bytes[32 * place : 32 * place + 32].hex()


class _Joined:
    """Sequences of any lengths, one behind the other: texts, or numbers of single precision."""

    __slots__ = ("_all", "_ends", "_kind")

    def __init__(self, joined: Any, values: Sequence[Any], kind: Callable[[Any], Any]) -> None:
        self._all, self._kind = joined, kind
        self._ends = array("I", accumulate(map(len, values), initial=0))

    def __getitem__(self, place: int) -> Any:
        return self._kind(self._all[self._ends[place] : self._ends[place + 1]])


class _Named:
    """Numbers by name, of the same names in all rows."""

    __slots__ = ("_names", "_numbers")

    def __init__(self, names: tuple[str, ...], numbers: array[float]) -> None:
        self._names, self._numbers = names, numbers

    def __getitem__(self, place: int) -> tuple[tuple[str, float], ...]:
        count = len(self._names)
        numbers = self._numbers[count * place : count * (place + 1)]
        return tuple(zip(self._names, numbers, strict=True))


class _Maybe:
    """Real numbers, or none: rows hold no NaN."""

    __slots__ = ("_numbers",)

    def __init__(self, values: Iterable[float | None]) -> None:
        self._numbers = array("d", (float("nan") if v is None else v for v in values))

    def __getitem__(self, place: int) -> float | None:
        value = self._numbers[place]
        return value if value == value else None  # noqa: PLR0124  # NaN is not itself.


def _packed(values: Sequence[Any]) -> _Values:
    """Return values that give each back as it was, with its type and its sign of zero."""
    kinds = set(map(type, values))
    if kinds == {float}:
        numbers = array("d", values)
        is_same = numbers.tobytes() == numbers[:1].tobytes() * len(values)
        return _Same(values[0]) if is_same else numbers
    if kinds == {int}:
        return _Same(values[0]) if len(set(values)) == 1 else array("Q", values)
    if kinds == {str}:
        return _packed_texts(values)
    if kinds == {bool}:
        return _Words((False, True), bytes(values))
    if kinds == {float, type(None)}:
        return _Maybe(values)
    if kinds == {tuple}:
        return _packed_lists(values)
    return _Same(values[0]) if kinds == {type(None)} else tuple(values)


_WORDS = 64
_DIGITS = frozenset("0123456789abcdef")


def _packed_texts(values: Sequence[str]) -> _Values:
    distinct = tuple(dict.fromkeys(values))
    if len(distinct) == 1:
        return _Same(values[0])
    if len(distinct) <= _WORDS:
        numbers = {word: number for number, word in enumerate(distinct)}
        return _Words(distinct, bytes(map(numbers.__getitem__, values)))
    joined = "".join(values)
    if set(map(len, values)) == {64} and _DIGITS.issuperset(joined):
        return _Hex(joined)
    return _Joined(joined, values, str)


def _packed_lists(values: Sequence[tuple[Any, ...]]) -> _Values:
    items = tuple(chain.from_iterable(values))
    kinds = set(map(type, items))
    if not items:
        return _Same(())
    if kinds == {float}:
        numbers = array("f", items)
        return _Joined(numbers, values, tuple) if tuple(numbers) == items else tuple(values)
    names = tuple(name for name, _ in values[0]) if kinds == {tuple} else ()
    alike = all(len(value) == len(names) for value in values) and names
    if alike and all(name == names[k % len(names)] for k, (name, _) in enumerate(items)):
        numbers = [number for _, number in items]
        if set(map(type, numbers)) == {float}:
            return _Named(names, array("d", numbers))
    return tuple(values)


class StoredRow:
    """A row that looks its values up; otherwise a `Row`."""

    __slots__ = ("columns", "place")
    __hash__ = Row.__hash__

    digest, standing, lost_its_log = Row.digest, Row.standing, Row.lost_its_log

    def __new__(cls, **values: Any) -> Self:
        """Return a plain row: `dataclasses.replace` asks for one with other values."""
        return cast("Self", Row(**values))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Row | StoredRow):
            return NotImplemented
        return to_dict(cast("Row", self)) == to_dict(cast("Row", other))

    def __repr__(self) -> str:
        return repr(Row(**to_dict(cast("Row", self))))

    def __reduce__(self) -> tuple[Any, ...]:
        return _plain, (to_dict(cast("Row", self)),)


def _plain(values: dict[str, Any]) -> Row:
    return Row(**values)


def _looked_up(name: str) -> property:
    def value(row: Any) -> Any:
        return row.columns[name][row.place]

    return property(value)


for _name in COLUMNS:
    setattr(StoredRow, _name, _looked_up(_name))
# `dataclasses.replace` asks for them.
setattr(StoredRow, "__dataclass_fields__", Row.__dataclass_fields__)  # noqa: B010

_new: Callable[[type[StoredRow]], Any] = object.__new__


def _row(columns: dict[str, _Values], place: int) -> Row:
    row = _new(StoredRow)
    row.columns, row.place = columns, place
    return row


class _Packer:
    """Rows that come one after another, by index."""

    def __init__(self) -> None:
        self._portions: list[dict[str, _Values]] = []
        self._rows: list[Row] = []  # Those that are not packed.

    def __len__(self) -> int:
        return len(self._portions) * _PORTION + len(self._rows)

    def append(self, row: Row) -> None:
        self._rows.append(row)

    def pack(self) -> None:
        """Pack whole portions, if there are many rows."""
        if len(self._rows) < (_PORTION if self._portions else FEW):
            return
        whole = len(self._rows) - len(self._rows) % _PORTION
        for first in range(0, whole, _PORTION):
            columns = by_column(self._rows[first : first + _PORTION])
            self._portions.append({name: _packed(each) for name, each in columns.items()})
        self._rows = self._rows[whole:]

    def at(self, place: int) -> Row:
        return _at(self._portions, self._rows, place)

    def rows(self, order: Iterable[int] | None) -> Sequence[Row]:
        if not self._portions:
            return tuple(self._rows if order is None else map(self._rows.__getitem__, order))
        places = None if order is None else array("I", order)
        return StoredRows(list(self._portions), list(self._rows), places)


def stored(portions: Iterable[Iterable[Row]]) -> Sequence[Row]:
    """Return all rows of some portions, in their order, in little memory where they are many."""
    packer = _Packer()
    for rows in portions:
        for row in rows:
            packer.append(row)
        packer.pack()
    return packer.rows(None)


class RowStore:
    """Rows that come one after another: the latest of each trial.

    Args:
        which: from a trial's earlier row and a later one to the one that stands.
    """

    def __init__(self, which: Callable[[Row | None, Row], Row]) -> None:
        self._which = which
        self._places: dict[str, int] = {}
        self._packer = _Packer()
        self._is_mixed = False  # Whether a row stands where another one came.

    def extend(self, rows: Iterable[Row]) -> None:
        """Keep rows.

        Raises:
            StoreError: as `which`; those before the row are kept.
        """
        for row in rows:
            here = self._places.get(row.trial_id)
            stands = self._which(None if here is None else self._packer.at(here), row)
            if here is None or stands is row:
                self._is_mixed = self._is_mixed or here is not None
                self._places[row.trial_id] = len(self._packer)
                self._packer.append(row)
        self._packer.pack()

    def get(self, trial: str) -> Row | None:
        """Return the row of a trial; None if it has none."""
        here = self._places.get(trial)
        return None if here is None else self._packer.at(here)

    def rows(self) -> Sequence[Row]:
        """Return the rows that stand, in the order in which their trials came first."""
        return self._packer.rows(self._places.values() if self._is_mixed else None)


class StoredRows(Sequence[Row]):
    """Rows as `RowStore` keeps many of them. Equal to any sequence of equal rows."""

    def __init__(
        self,
        portions: Sequence[dict[str, _Values]],
        last: Sequence[Row],
        order: array[int] | None,
    ) -> None:
        self._portions, self._last, self._order = portions, last, order

    def __len__(self) -> int:
        if self._order is not None:
            return len(self._order)
        return len(self._portions) * _PORTION + len(self._last)

    @overload
    def __getitem__(self, index: int) -> Row: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Row]: ...
    def __getitem__(self, index: int | slice) -> Row | Sequence[Row]:
        if isinstance(index, slice):
            return [self._at(place) for place in range(*index.indices(len(self)))]
        if not -len(self) <= index < len(self):
            raise IndexError(f"row {index} of {len(self)}")
        return self._at(index % len(self))

    def __iter__(self) -> Iterator[Row]:
        return map(self._at, range(len(self)))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Sequence):
            return NotImplemented
        rows = cast("Sequence[Any]", other)
        return len(self) == len(rows) and all(map(eq, self, rows))

    def __hash__(self) -> int:
        return hash(tuple(self))

    def _at(self, place: int) -> Row:
        place = place if self._order is None else self._order[place]
        return _at(self._portions, self._last, place)


def _at(portions: Sequence[dict[str, _Values]], last: Sequence[Row], place: int) -> Row:
    """Return a row of packed portions, or of those behind them."""
    number, within = divmod(place, _PORTION)
    if number < len(portions):
        return _row(portions[number], within)
    return last[place - len(portions) * _PORTION]
