"""Calls of the policy as `nw.PolicyStep` messages, put together by hand.

They are written in every control step, and to fill in a message number by number costs far more.
The fields are those of `messages._MESSAGES`, in their order; what is zero or empty is left out, as
protobuf does.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from nw_eval.rollout.mcap.wire import sized, time_field, varint

_STEP, _OBSERVATION, _STATE = b"\x10", b"\x1a", b"\x3a"
_NUMBERS = (b"\x22", b"\x2a", b"\x32")


def policy_steps(
    times: Sequence[int],
    steps: Sequence[int],
    *,
    observations: Sequence[bytes],
    states: Sequence[bytes],
    numbers: NDArray[np.float64],
) -> Iterator[bytes]:
    """Yield messages, N.

    Args:
        times: of the calls, ns.
        steps: numbers of their control steps.
        observations: digests of what the policy was given.
        states: digests of what it remembers; empty where the log has no state.
        numbers: raw output, applied action and joint targets, (N, 3 J).
    """
    fields = _number_fields(numbers)
    each = zip(times, steps, observations, states, fields, strict=True)
    for time_ns, step, observation, state, values in each:
        parts = _head(time_ns, step), _field(_OBSERVATION, observation), values
        yield b"".join((*parts, _field(_STATE, state)) if state else parts)


@lru_cache(maxsize=4096)  # The steps of every trial have the same times.
def _head(time_ns: int, step: int) -> bytes:
    return time_field(time_ns) + (_STEP + varint(step) if step else b"")


def _field(field: bytes, digest: bytes) -> bytes:
    return field + sized(digest) if digest else b""


def _number_fields(rows: NDArray[np.float64]) -> list[bytes]:
    """Return the three fields of numbers, (N, 3 J), of each row."""
    count = len(rows)
    little = rows.astype("<f8", copy=False)
    values = np.frombuffer(little.tobytes(), np.uint8).reshape(count, 3, -1)
    size = values.shape[2]
    if not size:
        return [b""] * count
    heads = [field + varint(size) for field in _NUMBERS]
    found = np.empty((count, 3, len(heads[0]) + size), np.uint8)
    found[:, :, :-size] = np.frombuffer(b"".join(heads), np.uint8).reshape(3, -1)
    found[:, :, -size:] = values
    return [row.tobytes() for row in found]
