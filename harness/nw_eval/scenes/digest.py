"""Digests of values: the same on every machine, different when anything in them differs."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, Protocol

import numpy as np


def digest(*values: Any) -> str:
    """Return the hex SHA-256 of values.

    Understood are None, bool, int, float, str, bytes, arrays, sequences, mappings and dataclasses
    of these, at any depth. Floats count with all their bits.

    Raises:
        TypeError: a value of another type, whose identity could not be told.
    """
    state = hashlib.sha256()
    for value in values:
        _feed(state, value)
    return state.hexdigest()


class _State(Protocol):
    def update(self, data: bytes, /) -> None: ...


def _feed(state: _State, value: Any) -> None:  # noqa: C901 - one case for each type of value.
    # Every value begins with its type and length, so that no two inputs give the same bytes.
    match value:
        case None | bool() | int():
            state.update(f"{type(value).__name__}:{value};".encode())
        case float():
            state.update(f"float:{value.hex()};".encode())
        case str() | bytes():
            data = value.encode() if isinstance(value, str) else value
            state.update(f"{type(value).__name__}:{len(data)};".encode() + data)
        case np.ndarray():
            array = np.ascontiguousarray(value.astype(value.dtype.newbyteorder("<"), copy=False))
            state.update(f"array:{array.dtype.str}:{array.shape};".encode() + array.tobytes())
        case tuple() | list():
            state.update(f"sequence:{len(value)};".encode())
            for item in value:
                _feed(state, item)
        case Mapping():
            state.update(f"mapping:{len(value)};".encode())
            for key in sorted(value):
                _feed(state, key)
                _feed(state, value[key])
        case _ if is_dataclass(value) and not isinstance(value, type):
            state.update(f"{type(value).__name__};".encode())
            for field in fields(value):
                _feed(state, field.name)
                _feed(state, getattr(value, field.name))
        case _:
            raise TypeError(f"cannot digest a {type(value).__name__}: {value!r}")
