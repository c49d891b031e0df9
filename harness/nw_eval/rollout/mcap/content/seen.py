"""What a policy was given in a control step: its digest, and its rows of numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
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
