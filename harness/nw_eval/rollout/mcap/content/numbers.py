"""Rows of numbers that a policy was given, as `nw.Observation` messages, and read back."""

from __future__ import annotations

from functools import lru_cache
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.rollout.mcap.form import BLANK_TIME, Form
from nw_eval.rollout.mcap.messages import Observation, Term
from nw_eval.rollout.mcap.stamps import stamp

# Bits of floats that stand for what is filled in. All four bytes of none lie across two others.
_BLANK = 0x7F000000


Terms = tuple[tuple[str, int], ...]
"""Name and number of values of each part of an observation, in their order."""


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
