"""Records of messages in an MCAP file (https://mcap.dev/spec), alone or many at a time."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Sequence
from itertools import accumulate
from typing import Any, NamedTuple, Protocol

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import ArrayLike, NDArray

from nw_eval.rollout.mcap.form import Form, long_times

Integers = NDArray[np.int64]

# Opcode, length; channel, sequence, log time, publish time. The data follow.
_HEAD = struct.Struct("<BQHIQQ")
_AFTER_LENGTH = _HEAD.size - 9
_TIMES = _HEAD.size - 16  # where the two times begin


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
    found = [np.empty((0, 4), np.int64)]
    for goes_to, batch in parts:
        for number, piece in zip(goes_to, batch.pieces, strict=True):
            pieces[number].append(piece)
        numbers = np.asarray(goes_to, np.int64)
        index = batch.places.copy()
        index[:, 2] = numbers[batch.places[:, 2]]
        index[:, 3] += sizes[index[:, 2]]
        found.append(index)
        sizes[numbers] += np.array([len(piece) for piece in batch.pieces], np.int64)
    rows = np.concatenate(found)
    whole = [b"".join(each) for each in pieces]
    return Batch(whole, rows[np.lexsort((rows[:, 3], rows[:, 2]))])


def _index(channels: ArrayLike, times: ArrayLike, starts: ArrayLike) -> Integers:
    """Return the index of N pieces at `times` (N,), with records (N, K) in each."""
    times = np.asarray(times, np.int64)
    count = len(times)
    found = np.empty((count, np.size(starts), 4), np.int64)
    found[:, :, 0] = channels
    found[:, :, 1] = times[:, np.newaxis]
    found[:, :, 2] = np.arange(count)[:, np.newaxis]
    found[:, :, 3] = starts
    return found.reshape(-1, 4)
