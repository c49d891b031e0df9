"""The container of PLY: a text header, then rows of numbers and of lists of numbers."""

from __future__ import annotations

import re
import struct
import warnings
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_base.clean import clean
from nw_base.errors import SceneError

_HEADER_LIMIT = 1 << 16
_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_CODES = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I"}
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}
_AGAIN = "export the file again"
_SHORT = "the file is cut short; copy it again"
_BLOCK = 1 << 18
_NUMBER = re.compile(
    r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?|[+-]?(?:nan|inf)", re.IGNORECASE
)


_SETTING = re.compile(r"[\w .-]{1,40}[:=]\s*\S")
_PROSE = re.compile(
    r"(generat|creat|export|made|written|author|date|software|source|version|https?)", re.IGNORECASE
)


@dataclass(frozen=True, kw_only=True)
class PlyList:
    """The lists of one property.

    Attributes:
        counts: (rows,) int64, how many numbers each row's list has.
        values: (sum of counts,) the numbers, row after row.
    """

    counts: NDArray[np.int64]
    values: NDArray[Any]


@dataclass(frozen=True, kw_only=True)
class _Property:
    name: str
    kind: str
    count: str = ""
    """Type of a list's length; empty for a single number."""


@dataclass(frozen=True, kw_only=True)
class _Element:
    name: str
    rows: int
    line: int
    properties: list[_Property] = field(default_factory=list)

    @property
    def has_lists(self) -> bool:
        return any(one.count for one in self.properties)


@dataclass(frozen=True, kw_only=True)
class Ply:
    """The elements of a PLY file, binary or ASCII.

    Attributes:
        path: the file.
        elements: name to rows, in file order, as read-only structured arrays (those of a binary
            file lie over the mapped file); single numbers only.
        lists: element to property to lists.
        comments: the header's comments, and its lines of obj_info.
    """

    path: Path
    elements: dict[str, NDArray[np.void]]
    lists: dict[str, dict[str, PlyList]]
    comments: tuple[str, ...]

    @classmethod
    def open(cls, path: Path, *, most_rows: Mapping[str, int] | None = None) -> Ply:
        """Read the header and map or read the rows.

        Args:
            path: the file.
            most_rows: element to the most rows that are read of it.

        Raises:
            SceneError: for an unknown type, a row that is damaged, a file that is shorter than its
                header says, or more rows than `most_rows`.
        """
        with path.open("rb") as file:
            head = file.read(_HEADER_LIMIT)
            size = file.seek(0, 2)
        end = head.find(b"end_header")
        newline = head.find(b"\n", end)
        if end < 0 or newline < 0:
            raise SceneError(
                f"{path}: no end_header in its first {len(head)} bytes",
                fix="give a complete PLY file",
            )
        lines = head[:end].decode("latin-1").splitlines()
        order, layout, comments = _parse(path, lines)
        for element in layout:
            if element.rows > (most_rows or {}).get(element.name, element.rows):
                raise SceneError(
                    f"{path}:{element.line}: {element.rows} {element.name} rows",
                    fix=f"decimate it below {(most_rows or {})[element.name]}",
                )
            # Rows without a property would be free.
            if element.rows > size:
                raise SceneError(
                    f"{path}:{element.line}: {element.rows} rows of {element.name[:40]!r} in "
                    f"{size} bytes",
                    fix=_SHORT,
                )
        if order:
            elements, lists = _binary(path, order, layout, newline + 1, size)
        else:
            elements, lists = _ascii(path, layout, newline + 1, len(lines) + 1)
        return cls(path=path, elements=elements, lists=lists, comments=tuple(comments))

    def columns(
        self, element: str, names: list[str], *, rows: slice | None = None
    ) -> NDArray[np.float32]:
        """Return (rows, names) float32 columns of an element.

        Raises:
            SceneError: naming the first column that is missing.
        """
        table = self.elements[element]
        known = table.dtype.names or ()
        for name in names:
            if name not in known:
                raise SceneError(
                    f"{self.path}: element {element} has no property {name}",
                    fix="give a Gaussian splat, not a plain point cloud or mesh",
                )
        table = table if rows is None else table[rows]
        out = np.empty((len(table), len(names)), dtype=np.float32)
        with np.errstate(over="ignore", invalid="ignore"):
            for i, name in enumerate(names):
                out[:, i] = table[name]
        return out

    def remarks(self, element: str, used: Collection[str], silent: Collection[str]) -> list[str]:
        """Return which properties of an element are neither `used` nor, of no effect, `silent`."""
        names = (*(self.elements[element].dtype.names or ()), *self.lists.get(element, {}))
        left = [clean(n, at_most=40) for n in names if n not in used and n not in silent]
        return [f"properties of {element} that are not read: {', '.join(left)}"] if left else []

    def unread_comments(self, used: re.Pattern[str]) -> list[str]:
        """Return comments `name: value` that are not `used`, nor say who wrote the file."""
        return [
            f"comment that is not read: {clean(one, at_most=80)}"
            for one in self.comments
            if _SETTING.match(one) and not _PROSE.match(one) and not used.fullmatch(one)
        ]


def _parse(path: Path, lines: list[str]) -> tuple[str, list[_Element], list[str]]:
    """Return the order of bytes (empty: ASCII), the elements and the comments of a header."""
    order: str | None = None
    layout: list[_Element] = []
    comments: list[str] = []
    for number, line in enumerate(lines, 1):
        match line.split():
            case [] | ["ply"]:
                pass
            case ["comment" | "obj_info", *_]:  # Both words have eight letters with the space.
                comments.append(line[8:].strip())
            case ["format", kind, _version] if kind in _ORDERS:
                order = _ORDERS[kind]
            case ["element", name, count] if count.isascii() and count.isdigit():
                layout.append(_Element(name=name, rows=int(count[:18]), line=number))
            case ["property", kind, name] if layout and kind in _TYPES:
                layout[-1].properties.append(_Property(name=name, kind=_TYPES[kind]))
            case ["property", "list", count, kind, name] if (
                layout and kind in _TYPES and _TYPES.get(count) in _CODES
            ):
                layout[-1].properties.append(
                    _Property(name=name, kind=_TYPES[kind], count=_TYPES[count])
                )
            case _:
                raise SceneError(
                    f"{path}:{number}: header line not understood: {line[:80]!r}", fix=_AGAIN
                )
    if order is None or not layout:
        raise SceneError(f"{path}: its header names no format or no element", fix=_AGAIN)
    _check_names(path, layout)
    return order, layout, comments


def _check_names(path: Path, layout: list[_Element]) -> None:
    for element in layout:
        names = [one.name for one in element.properties]
        if len(set(names)) < len(names):
            raise SceneError(
                f"{path}:{element.line}: element {element.name[:40]} has a property twice",
                fix=_AGAIN,
            )


_Read = tuple[dict[str, NDArray[np.void]], dict[str, dict[str, PlyList]]]


def _binary(path: Path, order: str, layout: list[_Element], offset: int, size: int) -> _Read:
    elements: dict[str, NDArray[np.void]] = {}
    lists: dict[str, dict[str, PlyList]] = {}
    data = np.memmap(path, np.uint8, "r") if any(one.has_lists for one in layout) else None
    for element in layout:
        if element.has_lists and data is not None:
            try:
                rows, mine, offset = _rows_with_lists(data, order, element, offset)
            except (struct.error, ValueError) as error:
                raise SceneError(
                    f"{path}: the {element.rows} {element.name[:40]} rows do not end within the "
                    f"file's {size} bytes: {error}",
                    fix=_SHORT,
                ) from None
            elements[element.name], lists[element.name] = rows, mine
            continue
        row = np.dtype([(one.name, order + one.kind) for one in element.properties])
        needed = element.rows * row.itemsize
        if offset + needed > size:
            raise SceneError(
                f"{path}: {element.rows} {element.name} rows need {needed} bytes, "
                f"{size - offset} are left",
                fix=_SHORT,
            )
        if element.rows and row.itemsize:
            elements[element.name] = np.memmap(path, row, "r", offset, (element.rows,))
        else:
            elements[element.name] = np.zeros(0, row)
        offset += needed
    return elements, lists


def _rows_with_lists(
    data: NDArray[np.uint8], order: str, element: _Element, offset: int
) -> tuple[NDArray[np.void], dict[str, PlyList], int]:
    """Return single numbers, lists, and where the element ends.

    Raises:
        ValueError, struct.error: it ends after the file does, or a list is shorter than nothing.
    """
    kinds = {one.name: np.dtype(order + one.kind) for one in element.properties}
    plain = [(one.name, kinds[one.name]) for one in element.properties if not one.count]
    listed = [one.name for one in element.properties if one.count]
    if element.rows == 0:
        none = {
            name: PlyList(counts=np.zeros(0, np.int64), values=np.zeros(0, kinds[name]))
            for name in listed
        }
        return np.zeros(0, plain), none, offset
    alike = _alike_rows(data, order, element, offset)
    if alike is not None:
        table, counts = alike
        rows = np.zeros(element.rows, plain)
        for name, _ in plain:
            rows[name] = table[name]
        lists = {
            name: PlyList(
                counts=np.full(element.rows, n, np.int64),
                values=table[name].reshape(-1) if n else np.zeros(0, kinds[name]),
            )
            for name, n in zip(listed, counts, strict=True)
        }
        return rows, lists, offset + table.nbytes
    starts, counts, end = _walk(data, order, element, offset, element.rows)
    rows = np.zeros(element.rows, plain)
    lists = {}
    for one, first, many in zip(element.properties, starts, counts, strict=True):
        kind = kinds[one.name]
        values = np.empty(int(many.sum()), kind)
        places = np.cumsum(many) - many
        for n in np.unique(many[many > 0]).tolist():
            matches = np.flatnonzero(many == n)
            for i in range(0, len(matches), _BLOCK):
                mine = matches[i : i + _BLOCK]
                cells = data[first[mine, None] + np.arange(n * kind.itemsize)]
                values[places[mine, None] + np.arange(n)] = cells.view(kind)
        if one.count:
            lists[one.name] = PlyList(counts=many, values=values)
        else:
            rows[one.name] = values
    return rows, lists, end


def _alike_rows(
    data: NDArray[np.uint8], order: str, element: _Element, offset: int
) -> tuple[NDArray[np.void], list[int]] | None:
    """Return the rows as an array and the length of each list, if the first row's is every row's.

    Properties keep their names, and lengths are called by them after a zero byte.
    """
    _, lengths, _ = _walk(data, order, element, offset, 1)
    fields: list[tuple[Any, ...]] = []
    counts: list[int] = []
    for one, n in zip(element.properties, lengths[:, 0].tolist(), strict=True):
        if one.count:
            counts.append(n)
            fields += [("\0" + one.name, order + one.count), (one.name, order + one.kind, (n,))]
        else:
            fields.append((one.name, order + one.kind))
    row = np.dtype(fields)
    if offset + element.rows * row.itemsize > len(data):
        return None
    table = np.frombuffer(data, row, element.rows, offset)
    listed = [one.name for one in element.properties if one.count]
    if any((table["\0" + k] != n).any() for k, n in zip(listed, counts, strict=True)):
        return None
    return table, counts


def _walk(
    data: NDArray[np.uint8], order: str, element: _Element, offset: int, rows: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], int]:
    """Return (properties, rows) where numbers begin and how many there are, and the end."""
    raw: Any = memoryview(data.data)
    steps = [
        (
            np.dtype(one.kind).itemsize,
            np.dtype(one.count).itemsize if one.count else 0,
            struct.Struct((order + _CODES[one.count]) if one.count else "x").unpack_from,
        )
        for one in element.properties
    ]
    at = offset
    starts: list[int] = []
    counts: list[int] = []
    for _ in range(rows):
        for width, head, unpack in steps:
            n = 1
            if head:
                n = unpack(raw, at)[0]
                if n < 0:
                    raise ValueError(f"a list of {n}")
                at += head
            starts.append(at)
            counts.append(n)
            at += n * width
        if at > len(raw):
            raise ValueError("it is cut short")
    wide = len(steps)
    return (
        np.array(starts, np.int64).reshape(rows, wide).T,
        np.array(counts, np.int64).reshape(rows, wide).T,
        at,
    )


def _ascii(path: Path, layout: list[_Element], offset: int, header: int) -> _Read:
    """Read the rows of an ASCII file, one a line; `header` is the last line of the header."""
    with path.open("rb") as file:
        file.seek(offset)
        body = file.read().decode("latin-1").replace("\r\n", "\n").replace("\r", "\n").split("\n")
    numbered = [(header + 1 + i, line) for i, line in enumerate(body) if line.strip()]
    at = 0
    elements: dict[str, NDArray[np.void]] = {}
    lists: dict[str, dict[str, PlyList]] = {}
    for element in layout:
        lines = numbered[at : at + element.rows]
        at += element.rows
        if len(lines) < element.rows:
            raise SceneError(
                f"{path}: {element.rows} {element.name[:40]} rows are said, {len(lines)} are there",
                fix=_SHORT,
            )
        rows, mine = _ascii_rows(path, element, lines)
        elements[element.name] = rows
        if element.has_lists:
            lists[element.name] = mine
    return elements, lists


def _ascii_numbers(
    path: Path, element: _Element, lines: list[tuple[int, str]], count: int
) -> NDArray[np.float64]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # Older NumPy warns where it stops.
        try:
            values = np.fromstring(" ".join(line for _, line in lines), np.float64, sep=" ")
        except (ValueError, DeprecationWarning):
            values = np.zeros(0)
    if len(values) == count:
        return values
    for number, line in lines:
        words = line.split()
        if any(not _NUMBER.fullmatch(word) for word in words):
            raise SceneError(
                f"{path}:{number}: a {element.name[:40]} row does not hold numbers: {line[:60]!r}",
                fix=_AGAIN,
            )
    return np.array([float(word) for _, line in lines for word in line.split()])


def _ascii_rows(
    path: Path, element: _Element, lines: list[tuple[int, str]]
) -> tuple[NDArray[np.void], dict[str, PlyList]]:
    widths = np.array([len(line.split()) for _, line in lines], np.int64)
    values = _ascii_numbers(path, element, lines, int(widths.sum()))
    firsts = np.cumsum(widths) - widths
    place = firsts.copy()  # Where each row's next number is.
    ends = firsts + widths
    rows = np.zeros(len(lines), [(o.name, o.kind) for o in element.properties if not o.count])
    lists: dict[str, PlyList] = {}

    def damaged(bad: NDArray[np.bool_]) -> SceneError:
        number, line = lines[int(np.flatnonzero(bad)[0])]
        return SceneError(
            f"{path}:{number}: a {element.name[:40]} row does not have the numbers of the header: "
            f"{line[:60]!r}",
            fix=_AGAIN,
        )

    with np.errstate(all="ignore"):
        for one in element.properties:
            if (place >= ends).any():
                raise damaged(place >= ends)
            if not one.count:
                rows[one.name] = values[place].astype(one.kind)
                place += 1
                continue
            sizes = values[place]
            place += 1
            bad = ~((sizes >= 0) & (sizes == np.floor(sizes)) & (place + sizes <= ends))
            if bad.any():
                raise damaged(bad)
            counts = sizes.astype(np.int64)
            row = np.repeat(np.arange(len(lines)), counts)
            within = np.arange(len(row)) - np.repeat(np.cumsum(counts) - counts, counts)
            mine = values[place[row] + within]
            kind = one.kind if one.kind[0] == "f" else "i8"  # A wide number is told, not wrapped.
            lists[one.name] = PlyList(counts=counts, values=mine.astype(kind))
            place += counts
    if (place != ends).any():
        raise damaged(place != ends)
    return rows, lists
