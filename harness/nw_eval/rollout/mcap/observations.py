"""What a policy was given in a control step: its digest, and its rows of numbers.

Rows are `nw.Observation` messages, which are read back here too.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from hashlib import sha256
from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nw_eval.rollout.mcap.batch import BLANK_TIME, Form
from nw_eval.rollout.mcap.messages import Observation, Term, stamp

Rows = NDArray[np.uint8]
# Bits of floats that stand for what is filled in. All four bytes of none lie across two others.
_BLANK = 0x7F000000


Terms = tuple[tuple[str, int], ...]
"""Name and number of values of each part of an observation, in their order."""


class SeenRow(NamedTuple):
    """An observation that is a row of numbers, as the log has it."""

    topic: str
    shape: tuple[int, ...]
    terms: Terms


def observation_digest(observation: Mapping[str, NDArray[Any]]) -> bytes:
    """Return the SHA-256 of observations: names in order, types, shapes and bytes."""
    total = sha256()
    for name in sorted(observation):
        array = np.ascontiguousarray(observation[name])
        total.update(_title(name, array.dtype, array.shape))
        total.update(array.data)
    return total.digest()


class SeenRows:
    """The observations of one policy that are rows of numbers, noted as bytes.

    Args:
        rows: by name, in the order in which they are given.
        is_all: whether the policy is given nothing else.
    """

    def __init__(self, rows: Mapping[str, SeenRow], *, is_all: bool) -> None:
        self._rows = rows
        self._is_all = is_all
        # Where each lies in the bytes, its type and shape: the same in every step.
        self._places: dict[str, tuple[slice, np.dtype[Any], tuple[int, ...]]] = {}

    def note(self, observation: Mapping[str, NDArray[Any]]) -> tuple[bytes, Iterable[bytes]]:
        """Return the digest of all observations, and the bytes of each row among them.

        The digest is empty where it follows from those bytes: see `digests`.
        """
        if not observation:
            return _NOTHING, ()
        digest, rows = b"", observation
        if not self._is_all:
            digest = observation_digest(observation)
            rows = {name: observation[name] for name in self._rows}
        if not self._places:
            self._place(rows)
        return digest, map(np.ndarray.tobytes, rows.values())

    def digests(self, noted: Sequence[bytes]) -> list[bytes]:
        """Return the `observation_digest` of N steps, of which the joined rows were noted."""
        rows = stacked_bytes(noted)
        parts: list[Rows] = []
        for name in sorted(self._places):
            place, kind, shape = self._places[name]
            title = np.frombuffer(_title(name, kind, shape), np.uint8)
            parts += np.broadcast_to(title, (len(rows), len(title))), rows[:, place]
        return [sha256(row).digest() for row in np.concatenate(parts, axis=1)]

    def numbers(
        self, new: Sequence[bool], noted: Sequence[bytes]
    ) -> tuple[dict[str, Form], list[NDArray[np.float32]]]:
        """Return the forms of rows by topic, and what is filled in, (N, ...) each.

        Args:
            new: which rows are wanted.
            noted: the joined rows of N steps.
        """
        forms: dict[str, Form] = {}
        numbers: list[NDArray[np.float32]] = []
        rows = stacked_bytes(noted) if any(new) else np.empty((0, 0), np.uint8)
        for (name, row), is_new in zip(self._rows.items(), new, strict=True):
            if is_new:
                place, kind, _ = self._places[name]
                forms[row.topic] = observation_form(row.shape, row.terms)
                values = np.ascontiguousarray(rows[:, place]).view(kind)
                numbers.append(values.astype("<f4", copy=False))
        return forms, numbers

    def _place(self, rows: Mapping[str, NDArray[Any]]) -> None:
        start = 0
        for name, array in rows.items():
            end = start + array.nbytes
            self._places[name] = slice(start, end), array.dtype, np.ascontiguousarray(array).shape
            start = end


def stacked_bytes(noted: Sequence[bytes]) -> Rows:
    """Return bytes of one length as rows."""
    return np.frombuffer(b"".join(noted), np.uint8).reshape(len(noted), -1)


@lru_cache(maxsize=256)  # They are the same in every control step.
def _title(name: str, kind: np.dtype[Any], shape: tuple[int, ...]) -> bytes:
    return f"{name} {kind.str} {shape}".encode()


_NOTHING = observation_digest({})


@lru_cache(maxsize=32)
def observation_form(shape: tuple[int, ...], terms: Terms) -> Form:
    """Return the form of an observation: float32, last axis fastest, by terms.

    Args:
        shape: of the observation, with some thousand numbers at most.
        terms: its parts.

    Raises:
        ValueError: there are too many numbers for a form.
    """
    blanks: list[bytes] = []
    first = _BLANK
    message = Observation(timestamp=BLANK_TIME, shape=shape)
    for name, size in terms:
        blank = np.arange(first, first + size, dtype="<u4")
        first += size
        blanks.append(blank.tobytes())
        message.terms.append(Term(name=name, values=blank.view("<f4").tolist()))
    return Form(message, blanks)


def observation_message(time_ns: int, name: str, array: NDArray[Any]) -> Any:
    """Return an observation of any size, as one term of its own name."""
    term = Term(name=name, values=array.ravel().astype(np.float32).tolist())
    return Observation(timestamp=stamp(time_ns), shape=array.shape, terms=[term])


def values_of(message: Any) -> NDArray[np.float32]:
    """Return an observation's numbers in its shape.

    Raises:
        ValueError: it is damaged.
    """
    parts = [np.array(term.values, np.float32) for term in message.terms]
    values = np.concatenate(parts) if parts else np.empty(0, np.float32)
    if values.size != prod(message.shape):
        raise ValueError(f"an observation of {tuple(message.shape)} has {values.size} numbers")
    return values.reshape(tuple(message.shape))
