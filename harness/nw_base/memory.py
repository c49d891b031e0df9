"""What remembers something from one control step to the next, so that a trial can be saved.

What sensors and policies remember are named arrays, as bytes in the snapshot of a trial and back: a
JSON list of (name, dtype, shape), its length before it in 4 bytes, and the numbers behind it in
C order. An .npz file would say the same, with the overhead of a zip archive at every snapshot.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

Arrays = dict[str, NDArray[Any]]
"""Arrays of numbers by name; `pack` and `unpack` turn them into bytes and back."""

State = TypeVar("State")


class Memory(Protocol[State]):
    """A part of a trial whose future depends on its past.

    The parts that a trial is saved by give bytes. What lies inside such a part gives `Arrays`,
    which the part packs together with its own.
    """

    def state(self) -> State:
        """Return what its future depends on, beside what it will be shown."""
        ...

    def restore(self, state: State) -> None:
        """Go back, or on, to a `state` of the same trial, bit for bit.

        Raises:
            TrialError, KeyError, TypeError, ValueError: it is damaged, or of something else.
        """
        ...


class Forgetful:
    """What stands among those that remember, and remembers nothing."""

    def state(self) -> Arrays:
        """Return nothing."""
        return {}

    def restore(self, state: Arrays) -> None:
        """Go back to nothing."""


_NUMBERS = "biuf"
# All that `pack` writes; other texts make numpy parse them, with errors of all kinds.
_DTYPE = re.compile(r"[<|][biuf]\d{1,2}")


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Return a view of an array that cannot be written into, for code that is not ours."""
    view = array.view()
    view.flags.writeable = False
    return view


def pack(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Return arrays of numbers or booleans as bytes; equal arrays give equal bytes, none give none.

    Raises:
        TypeError: an array holds something else.
    """
    if not arrays:
        return b""
    kinds = tuple([(name, array.dtype, array.shape) for name, array in arrays.items()])
    header, is_little = _header(kinds)
    if not is_little:
        little = [array.astype(array.dtype.newbyteorder("<")) for array in arrays.values()]
        return b"".join([header, *[array.tobytes() for array in little]])
    return b"".join([header, *[array.tobytes() for array in arrays.values()]])


@lru_cache(maxsize=256)  # A snapshot has the same arrays as the one before.
def _header(kinds: tuple[tuple[str, np.dtype[Any], tuple[int, ...]], ...]) -> tuple[bytes, bool]:
    """Return what stands before the numbers, and whether they lie there as they are."""
    listed: list[tuple[str, str, tuple[int, ...]]] = []
    for name, kind, shape in kinds:
        if kind.kind not in _NUMBERS:
            raise TypeError(f"array {name!r} is of {kind}")
        listed.append((name, kind.newbyteorder("<").str, shape))
    header = json.dumps(listed).encode()
    is_little = all(kind.str[0] != ">" for _, kind, _ in kinds)
    return len(header).to_bytes(4, "little") + header, is_little


def unpack(data: bytes) -> dict[str, NDArray[Any]]:
    """Return the arrays of `pack`, each in memory of its own.

    Raises:
        ValueError: the bytes are no such arrays.
    """
    if not data:
        return {}
    start = 4 + int.from_bytes(data[:4], "little")
    arrays: dict[str, NDArray[Any]] = {}
    try:
        for name, kind, shape in json.loads(data[4:start]):
            if not _DTYPE.fullmatch(kind) or min(shape, default=0) < 0:
                raise ValueError(f"{name!r} is an array of {kind} with shape {shape}")
            flat = np.frombuffer(data, np.dtype(kind), math.prod(shape), start)
            arrays[str(name)] = flat.reshape(shape).copy()
            start += flat.nbytes
    except (TypeError, KeyError, OverflowError, RecursionError) as error:
        raise ValueError(f"no list of arrays: {error!r}") from None
    if start != len(data):
        raise ValueError(f"{len(data) - start} bytes are left over")
    return arrays
