"""Records of messages in an MCAP file (https://mcap.dev/spec), alone or many at a time.

A message of which only numbers change is made once, as a `Form`, and then filled in where the
numbers lie. To build a protobuf message anew in Python, number by number, costs more than a physics
step. The bytes of one that has the same fields every time differ in its numbers alone, whose places
never move: a `double` or a run of `float`s has a fixed length, and so has a time that is written in
the longest form that the wire format allows (https://protobuf.dev/programming-guides/encoding).
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Sequence
from itertools import accumulate
from typing import Any, NamedTuple, Protocol

import numpy as np
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.opcode import Opcode
from numpy.typing import ArrayLike, NDArray

_SECOND = 1_000_000_000
# A time that no trial has, whose varints are as long as any of a trial: 3 and 5 bytes.
BLANK_TIME = Timestamp(seconds=2**21 - 1, nanos=2**30 - 1)
_TIME = BLANK_TIME.SerializeToString()
Integers = NDArray[np.int64]

# Opcode, length; channel, sequence, log time, publish time. The data follow.
_HEAD = struct.Struct("<BQHIQQ")
_AFTER_LENGTH = _HEAD.size - 9
_TIMES = _HEAD.size - 16  # where the two times begin


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
        self._times = _offsets_of(data, _TIME)
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
    """Return records of some bytes, of which those at the positions are fields."""
    names, formats = [str(i) for i in range(len(sizes))], [f"V{size}" for size in sizes]
    layout: Any = {"names": names, "formats": formats, "offsets": places, "itemsize": length}
    return np.dtype(layout)


def long_times(times: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Return times, ns, as protobuf's (N, 10), all of the length of `BLANK_TIME`'s."""
    seconds, nanos = np.divmod(times, _SECOND)
    stamps = np.empty((len(times), len(_TIME)), np.uint8)
    stamps[:, 0], stamps[:, 4] = _TIME[0], _TIME[4]
    _put_long_varints(stamps[:, 1:4], seconds)
    _put_long_varints(stamps[:, 5:10], nanos)
    return stamps


def _put_long_varints(places: NDArray[np.uint8], values: NDArray[np.int64]) -> None:
    """Write varints of a fixed length: seven bits a byte, leading zeros written out."""
    last = places.shape[1] - 1
    for number in range(last + 1):
        more = 0x80 if number < last else 0
        places[:, number] = values >> 7 * number & 0x7F | more


def _only_place(data: bytes, blank: bytes) -> int:
    [place] = _offsets_of(data, blank)
    return place


def _offsets_of(data: bytes, part: bytes) -> list[int]:
    """Return where a part begins in the data."""
    offsets: list[int] = []
    at = data.find(part)
    while at >= 0:
        offsets.append(at)
        at = data.find(part, at + 1)
    return offsets


class Batch(NamedTuple):
    """Records of messages, in pieces that are not taken apart."""

    pieces: Sequence[bytes]
    """One or more records each, N."""
    places: Integers
    """Channel, time (ns), number of its piece and place in it (bytes) of each record, (M, 4)."""


Part = tuple[Sequence[int], Batch]
"""Pieces that go into larger ones: the number of the larger one for each, and the pieces."""

Channels = Callable[[str, type[Any]], int]
"""From a topic and the protobuf class of its messages to the number of its channel."""


class Notes(Protocol):
    """What is noted of messages until they are made, many at a time."""

    def take(self, channels: Channels) -> list[Part]:
        """Return the messages of all notes so far, N, as parts of N pieces, and forget them."""
        ...


def record(channel: int, time_ns: int, data: bytes) -> bytes:
    """Return the record of one message."""
    length = _AFTER_LENGTH + len(data)
    return _HEAD.pack(Opcode.MESSAGE, length, channel, 0, time_ns, time_ns) + data


def records(channels: Sequence[int], times: Sequence[int], data: Iterable[bytes]) -> Batch:
    """Return messages with channels, times (ns) and contents, N each, as a piece each."""
    pieces = [record(*each) for each in zip(channels, times, data, strict=True)]
    return Batch(pieces, _index(np.array(channels, np.int64)[:, np.newaxis], times, 0))


def filled(
    channels: Sequence[int],
    forms: Sequence[Form],
    times: Integers,
    numbers: Sequence[NDArray[np.generic]],
) -> Batch:
    """Return messages that are filled in, one of each form in each piece.

    Args:
        channels: one for each form.
        forms: of the messages that come together.
        times: ns, (N,).
        numbers: for each form those of its blanks and in their type, (N, ...).
    """
    count = len(times)
    *starts, length = accumulate((_HEAD.size + len(form) for form in forms), initial=0)
    rows = np.empty((count, length), np.uint8)
    raw = times.astype("<u8").view(np.uint8).reshape(count, 8)
    stamps = long_times(times)
    for channel, form, start, values in zip(channels, forms, starts, numbers, strict=True):
        head = _HEAD.pack(Opcode.MESSAGE, _AFTER_LENGTH + len(form), channel, 0, 0, 0)
        data = start + _HEAD.size
        rows[:, start:data] = np.frombuffer(head, np.uint8)
        rows[:, start + _TIMES : data - 8] = rows[:, data - 8 : data] = raw
        form.fill(rows[:, data : data + len(form)], stamps, values)
    return Batch([row.tobytes() for row in rows], _index(channels, times, starts))


def merged(count: int, parts: Sequence[Part]) -> Batch:
    """Return pieces that are put together from parts, in the order of these."""
    pieces: list[list[bytes]] = [[] for _ in range(count)]
    sizes = np.zeros(count, np.int64)
    indices = [np.empty((0, 4), np.int64)]
    for goes_to, batch in parts:
        for number, piece in zip(goes_to, batch.pieces, strict=True):
            pieces[number].append(piece)
        numbers = np.asarray(goes_to, np.int64)
        index = batch.places.copy()
        index[:, 2] = numbers[batch.places[:, 2]]
        index[:, 3] += sizes[index[:, 2]]
        indices.append(index)
        sizes[numbers] += np.array([len(piece) for piece in batch.pieces], np.int64)
    rows = np.concatenate(indices)
    whole = [b"".join(each) for each in pieces]
    return Batch(whole, rows[np.lexsort((rows[:, 3], rows[:, 2]))])


def _index(channels: ArrayLike, times: ArrayLike, starts: ArrayLike) -> Integers:
    """Return the index of N pieces at `times` (N,), with records (N, K) in each."""
    times = np.asarray(times, np.int64)
    count = len(times)
    index = np.empty((count, np.size(starts), 4), np.int64)
    index[:, :, 0] = channels
    index[:, :, 1] = times[:, np.newaxis]
    index[:, :, 2] = np.arange(count)[:, np.newaxis]
    index[:, :, 3] = starts
    return index.reshape(-1, 4)
