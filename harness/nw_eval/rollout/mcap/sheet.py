"""The messages of one topic that differ in their numbers alone, filled in many at a time.

A message in each control step costs more to make than a step of physics. Here it costs one `append`
when it happens; its bytes are made later, together with hundreds of others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.rollout.mcap.form import Form

Rows = Callable[[Sequence[Any]], NDArray[Any]]
"""From what was noted of N messages to their numbers (N, ...), in the type of the form's blanks."""


class Sheet:
    """What is noted of one topic's messages until they are written.

    Args:
        topic: of all of them.
        form: likewise.
        rows: what turns notes into numbers.
    """

    def __init__(self, topic: str, form: Form, rows: Rows) -> None:
        self.topic = topic
        self.kind: type[Any] = form.kind
        self._form = form
        self._rows = rows
        self._times: list[int] = []
        self._notes: list[Any] = []

    def note(self, time_ns: int, note: Any) -> None:
        """Keep what a message needs: nothing that changes afterwards."""
        self._times.append(time_ns)
        self._notes.append(note)

    def take(self) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
        """Return times (N) in ns and bytes (N, length) of the messages, and forget them."""
        times = np.array(self._times, np.int64)
        messages = self._form.filled(times, self._rows(self._notes))
        self._times, self._notes = [], []
        return times, messages


def rounded(numbers: NDArray[Any]) -> NDArray[np.float64]:
    """Return numbers of single precision in the places of double ones.

    They are for viewing, the exact ones are in `/nw/state`; the zero bits that this leaves compress
    well.
    """
    return numbers.astype(np.float32).astype("<f8")


def rounded_rows(notes: Sequence[Any]) -> NDArray[np.float64]:
    """Return notes, each a sequence of numbers or several of them, as rows of rounded numbers."""
    return rounded(np.array(notes, np.float64))


def single_rows(notes: Sequence[NDArray[Any]]) -> NDArray[np.float32]:
    """Return notes, each an array, as rows of numbers of single precision."""
    return np.array(notes, "<f4")
