"""Digests of values: the same on every machine, different when anything in them differs."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any

import numpy as np


def digest(*values: Any) -> str:
    """Return the hex SHA-256 of values.

    Understood are None, bool, int, float, str, bytes, arrays, sequences, mappings and dataclasses
    of these, at any depth. Floats count with all their bits.

    Raises:
        TypeError: a value of another type, whose identity could not be told.
    """
    parts: list[bytes] = []
    for value in values:
        _tell(parts, value)
    return hashlib.sha256(b"".join(parts)).hexdigest()


def _tell(parts: list[bytes], value: Any) -> None:
    """Append the bytes of a value, which tell its type and length first.

    So no two inputs give the same bytes. A scene is ten thousand numbers, names and dataclasses:
    these are known by their type alone, and what is derived from one is met below.
    """
    kind = type(value)
    if kind is float:
        parts.append(f"float:{value.hex()};".encode())
    elif kind is tuple:
        parts.append(f"sequence:{len(value)};".encode())
        for item in value:
            _tell(parts, item)
    elif kind is str:
        _tell_bytes(parts, "str", value.encode())
    elif names := _fields(kind):
        parts.append(f"{kind.__name__};".encode())
        for name in names:
            _tell_bytes(parts, "str", name.encode())
            _tell(parts, getattr(value, name))
    else:
        _tell_rest(parts, value)


def _tell_rest(parts: list[bytes], value: Any) -> None:
    name = type(value).__name__
    match value:
        case None | bool() | int():
            parts.append(f"{name}:{value};".encode())
        case float():
            parts.append(f"float:{value.hex()};".encode())
        case str() | bytes():
            _tell_bytes(parts, name, value.encode() if isinstance(value, str) else value)
        case np.ndarray():
            array = np.ascontiguousarray(value.astype(value.dtype.newbyteorder("<"), copy=False))
            parts.append(f"array:{array.dtype.str}:{array.shape};".encode() + array.tobytes())
        case tuple() | list():
            _tell(parts, tuple(value))
        case Mapping():
            parts.append(f"mapping:{len(value)};".encode())
            for key in sorted(value):
                _tell(parts, key)
                _tell(parts, value[key])
        case _ if is_dataclass(value) and not isinstance(value, type):  # It has no fields.
            parts.append(f"{name};".encode())
        case _:
            raise TypeError(f"cannot digest a {name}: {value!r}")


def _tell_bytes(parts: list[bytes], kind: str, data: bytes) -> None:
    parts += (f"{kind}:{len(data)};".encode(), data)


@cache
def _fields(kind: type) -> tuple[str, ...]:
    """Return the names of a dataclass's fields; none for another type."""
    return tuple(field.name for field in fields(kind)) if is_dataclass(kind) else ()
