"""What a policy was given in a control step: its digest, and its rows of numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from hashlib import sha256
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nw_eval.rollout.mcap.content.numbers import Terms, observation_form
from nw_eval.rollout.mcap.form import Form

Rows = NDArray[np.uint8]


class SeenRow(NamedTuple):
    """An observation that is a row of numbers, as the log has it."""

    topic: str
    shape: tuple[int, ...]
    terms: Terms

    @property
    def form(self) -> Form:
        """The form of its messages."""
        return observation_form(self.shape, self.terms)


class Given(NamedTuple):
    """What is noted of a control step's observations."""

    digest: bytes
    """Of all of them; empty if `data` holds them all."""
    data: bytes
    """`bytes_of` those that are rows of numbers."""
    layout: Layout
    """Of `data`."""
    new: tuple[str, ...]
    """Those in `data` that are new."""


def observation_digest(observation: Mapping[str, NDArray[Any]]) -> bytes:
    """Return the SHA-256 of observations: names in order, types, shapes and bytes."""
    total = sha256()
    for name in sorted(observation):
        array = np.ascontiguousarray(observation[name])
        total.update(_title(name, array.dtype, array.shape))
        total.update(array.data)
    return total.digest()


def bytes_of(observation: Mapping[str, NDArray[Any]]) -> bytes:
    """Return the bytes of observations one behind the other, for a `Layout`."""
    return b"".join([array.tobytes() for array in observation.values()])


class Layout:
    """Where what lies in the `bytes_of` observations, at every control step.

    Args:
        observation: those of one step.
    """

    def __init__(self, observation: Mapping[str, NDArray[Any]]) -> None:
        self._places: dict[str, tuple[slice, np.dtype[Any], tuple[int, ...]]] = {}
        start = 0
        for name, array in observation.items():
            end = start + array.nbytes
            self._places[name] = slice(start, end), array.dtype, np.ascontiguousarray(array).shape
            start = end

    def digests(self, data: Sequence[bytes]) -> list[bytes]:
        """Return the `observation_digest` of each step's bytes."""
        rows = rows_of_bytes(data)
        parts: list[Rows] = []
        for name in sorted(self._places):
            place, kind, shape = self._places[name]
            title = np.frombuffer(_title(name, kind, shape), np.uint8)
            parts += np.broadcast_to(title, (len(rows), len(title))), rows[:, place]
        return [sha256(row.data).digest() for row in np.concatenate(parts, axis=1)]

    def values(self, name: str, rows: Rows) -> NDArray[np.float32]:
        """Return the numbers of an observation in each row of bytes, in single precision."""
        place, kind, _ = self._places[name]
        return np.ascontiguousarray(rows[:, place]).view(kind).astype("<f4", copy=False)


NOTHING = Given(digest=observation_digest({}), data=b"", layout=Layout({}), new=())
"""What is noted where nothing was observed."""


def rows_of_bytes(notes: Sequence[bytes]) -> Rows:
    """Return bytes of one length as rows."""
    return np.frombuffer(b"".join(notes), np.uint8).reshape(len(notes), -1)


@lru_cache(maxsize=256)  # They are the same in every control step.
def _title(name: str, kind: np.dtype[Any], shape: tuple[int, ...]) -> bytes:
    return f"{name} {kind.str} {shape}".encode()
