"""The container of PLY: a text header, then rows of numbers."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import SceneError

_HEADER_LIMIT = 1 << 16
_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True, kw_only=True)
class Ply:
    """The elements of a binary PLY file, as read-only structured arrays over the mapped file.

    Attributes:
        path: the file.
        elements: name to rows, in file order.
        comments: the header's comments.
    """

    path: Path
    elements: dict[str, NDArray[np.void]]
    comments: tuple[str, ...]

    @classmethod
    def open(cls, path: Path) -> Ply:
        """Read the header and map the rows.

        Raises:
            SceneError: for ASCII files, lists, unknown types, and files shorter than their header
                says.
        """
        with path.open("rb") as file:
            head = file.read(_HEADER_LIMIT)
            size = file.seek(0, 2)
        end = head.find(b"end_header")
        newline = head.find(b"\n", end)
        if end < 0 or newline < 0:
            raise SceneError(
                f"{path}: no end_header in its first {len(head)} bytes", fix="give a whole PLY file"
            )
        lines = head[:end].decode("latin-1").splitlines()
        order, layout, comments = _parse(path, lines)
        offset = newline + 1
        elements: dict[str, NDArray[np.void]] = {}
        for name, count, properties in layout:
            try:
                row = np.dtype([(field, order + kind) for field, kind in properties])
            except ValueError as error:
                raise SceneError(f"{path}: element {name}: {error}", fix=_AGAIN) from error
            needed = count * row.itemsize
            if offset + needed > size:
                raise SceneError(
                    f"{path}: {count} {name} rows need {needed} bytes, {size - offset} are left",
                    fix="the file is cut short; copy it again",
                )
            if count and row.itemsize:
                elements[name] = np.memmap(path, row, "r", offset, (count,))
            else:
                elements[name] = np.zeros(0, row)
            offset += needed
        return cls(path=path, elements=elements, comments=tuple(comments))

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


_AGAIN = "export the file again"
_Layout = list[tuple[str, int, list[tuple[str, str]]]]


def _parse(path: Path, lines: list[str]) -> tuple[str, _Layout, list[str]]:
    order = ""
    layout: _Layout = []
    comments: list[str] = []
    for number, line in enumerate(lines, 1):
        match line.split():
            case [] | ["ply"] | ["obj_info", *_]:
                pass
            case ["comment", *_]:
                comments.append(line[8:].strip())
            case ["format", kind, _version]:
                if kind not in _ORDERS:
                    raise SceneError(
                        f"{path}:{number}: format {kind} is not read", fix="export binary PLY"
                    )
                order = _ORDERS[kind]
            case ["element", name, count] if count.isascii() and count.isdigit():
                layout.append((name, int(count[:18]), []))
            case ["property", kind, name] if layout and kind in _TYPES:
                layout[-1][2].append((name, _TYPES[kind]))
            case ["property", "list", *_] if layout and layout[-1][0] == "face":
                # Faces come last and are of no use here; whatever precedes them can be read.
                return order, layout[:-1], comments
            case _:
                raise SceneError(
                    f"{path}:{number}: header line not understood: {line[:80]!r}", fix=_AGAIN
                )
    if not order or not layout:
        raise SceneError(f"{path}: its header names no binary format or no element", fix=_AGAIN)
    return order, layout, comments
