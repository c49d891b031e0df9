"""Messages of which only numbers change: made once, and then filled in where the numbers lie.

To build a protobuf message anew in Python, number by number, costs more than a physics step. The
bytes of one that has the same fields every time differ in its numbers alone, whose places never
move: a `double` or a run of `float`s has a fixed length, and so has a time that is written in the
longest form that the wire format allows (https://protobuf.dev/programming-guides/encoding).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
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
        self._bytes = np.frombuffer(data, np.uint8)
        self._times = _starts(data, _TIME)
        # Where the numbers lie, as fields of two records: one call of NumPy copies all of them.
        sizes = [len(blank) for blank in blanks]
        places = [_only_place(data, blank) for blank in blanks]
        self._message = _fields(places, sizes, length=len(data))
        *starts, end = accumulate(sizes, initial=0)
        self._numbers = _fields(starts, sizes, length=end)

    def __len__(self) -> int:
        return len(self._bytes)

    @classmethod
    def of_doubles(cls, message: Any, count: int) -> Form:
        """Return the form of a message that has `blank_double(0)` to `blank_double(count - 1)`."""
        blanks = np.array([blank_double(number) for number in range(count)], "<f8")
        return cls(message, [blank.tobytes() for blank in blanks])

    def fill(
        self, rows: NDArray[np.uint8], stamps: NDArray[np.uint8], numbers: NDArray[Any]
    ) -> None:
        """Write the message many times, each (N) a row of bytes.

        Args:
            rows: where to, (N, bytes of the message).
            stamps: `long_times` of each, (N, 10).
            numbers: of each, (N, ...), of the blanks' own type.
        """
        rows[:] = self._bytes
        for at in self._times:
            rows[:, at : at + len(_TIME)] = stamps
        if self._numbers.names:
            packed = np.ascontiguousarray(numbers).view(np.uint8).reshape(len(rows), -1)
            rows.view(self._message)[:, 0] = packed.view(self._numbers)[:, 0]


def _fields(places: Sequence[int], sizes: Sequence[int], *, length: int) -> np.dtype[Any]:
    """Return records of some bytes, of which those at the places are fields."""
    names, formats = [str(i) for i in range(len(sizes))], [f"V{size}" for size in sizes]
    layout: Any = {"names": names, "formats": formats, "offsets": places, "itemsize": length}
    return np.dtype(layout)


def long_times(times: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Return times, ns, as protobuf's (N, 10), all of the length of `BLANK_TIME`'s."""
    seconds, nanos = np.divmod(times, _SECOND)
    found = np.empty((len(times), len(_TIME)), np.uint8)
    found[:, 0], found[:, 4] = _TIME[0], _TIME[4]
    _put_long_varints(found[:, 1:4], seconds)
    _put_long_varints(found[:, 5:10], nanos)
    return found


def _put_long_varints(places: NDArray[np.uint8], values: NDArray[np.int64]) -> None:
    """Write varints of a fixed length: seven bits a byte, leading zeros written out."""
    last = places.shape[1] - 1
    for number in range(last + 1):
        more = 0x80 if number < last else 0
        places[:, number] = values >> 7 * number & 0x7F | more


def _only_place(data: bytes, blank: bytes) -> int:
    [place] = _starts(data, blank)
    return place


def _starts(data: bytes, part: bytes) -> list[int]:
    """Return where a part begins in the data."""
    found: list[int] = []
    at = data.find(part)
    while at >= 0:
        found.append(at)
        at = data.find(part, at + 1)
    return found
