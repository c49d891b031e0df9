"""Messages of which only numbers change: made once, and then filled in where the numbers lie.

To build a protobuf message anew in Python, number by number, costs more than a physics step. The
bytes of one that has the same fields every time differ in its numbers alone, whose places never
move: a `double` or a run of `float`s has a fixed length, and so has a time that is written in the
longest form that the wire format allows (https://protobuf.dev/programming-guides/encoding).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from google.protobuf.timestamp_pb2 import Timestamp
from numpy.typing import NDArray

_SECOND = 1_000_000_000
# A time that no trial has, whose varints are as long as any of a trial: 3 and 5 bytes.
BLANK_TIME = Timestamp(seconds=2**21 - 1, nanos=2**30 - 1)
_TIME = BLANK_TIME.SerializeToString()


def blank_double(number: int) -> float:
    """Return a number that stands for the one that is filled in as `number`, from 0."""
    return 1e300 + number * 1e288


class Form:
    """The bytes of a message, with places for its time and its numbers.

    Args:
        message: with `BLANK_TIME` for its times.
        blanks: what stands where numbers go, little-endian, in the order in which they are given.

    Raises:
        ValueError: a blank is not to be found, or in several places.
    """

    def __init__(self, message: Any, blanks: Sequence[bytes]) -> None:
        data = message.SerializeToString(deterministic=True)
        self.kind: type[Any] = type(message)
        places = [_only_place(data, blank) for blank in blanks]
        self._numbers = np.concatenate(
            [np.arange(at, at + len(b)) for at, b in zip(places, blanks, strict=True)]
        )
        self._times = _starts(data, _TIME)[:, np.newaxis] + np.arange(len(_TIME))
        self._bytes = np.frombuffer(data, np.uint8).copy()

    @classmethod
    def of_doubles(cls, message: Any, count: int) -> Form:
        """Return the form of a message that has `blank_double(0)` to `blank_double(count - 1)`."""
        blanks = np.array([blank_double(number) for number in range(count)], "<f8")
        return cls(message, [blank.tobytes() for blank in blanks])

    def filled(self, time_ns: int, numbers: NDArray[Any]) -> bytes:
        """Return the message at a time, with numbers of the blanks' own type."""
        self._bytes[self._times] = _long_time(time_ns)
        self._bytes[self._numbers] = np.frombuffer(numbers.tobytes(), np.uint8)
        return self._bytes.tobytes()


@lru_cache(maxsize=1)  # All messages of a control step have one time.
def _long_time(time_ns: int) -> NDArray[np.uint8]:
    """Return a protobuf time of the length of `BLANK_TIME`'s."""
    seconds, nanos = divmod(time_ns, _SECOND)
    data = b"\x08" + _long_varint(seconds, 3) + b"\x10" + _long_varint(nanos, 5)
    return np.frombuffer(data, np.uint8)


def _long_varint(value: int, size: int) -> bytes:
    """Return a varint of `size` bytes, seven bits in each, whose leading zeros are written out."""
    more = [value >> 7 * k & 0x7F | 0x80 for k in range(size - 1)]
    return bytes([*more, value >> 7 * (size - 1)])


def _only_place(data: bytes, blank: bytes) -> int:
    [place] = _starts(data, blank)
    return int(place)


def _starts(data: bytes, part: bytes) -> NDArray[np.intp]:
    """Return where a part begins in the data."""
    found: list[int] = []
    at = data.find(part)
    while at >= 0:
        found.append(at)
        at = data.find(part, at + 1)
    return np.array(found, dtype=np.intp)
