"""One call of the policy as the bytes of an `nw.PolicyStep`, put together by hand.

It is written in every control step, and to fill in a message number by number costs five times as
much. The fields are those of `messages._MESSAGES`, in their order; what is zero or empty is left
out, as protobuf does (https://protobuf.dev/programming-guides/encoding).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from nw_eval.rollout.mcap.stamps import stamp

_TIME, _STEP, _OBSERVATION, _STATE = b"\x0a", b"\x10", b"\x1a", b"\x3a"
_NUMBERS = (b"\x22", b"\x2a", b"\x32")


def policy_step(
    time_ns: int,
    *,
    step: int,
    observation_digest: bytes,
    state_digest: bytes,
    numbers: Sequence[NDArray[np.float64]],
) -> bytes:
    """Return the message.

    Args:
        time_ns: simulated.
        step: number of the control step.
        observation_digest: of what the policy was given.
        state_digest: of what it remembers; empty where the log has no state.
        numbers: raw output, applied action and joint targets, of any size.
    """
    parts = [_TIME, _sized(_stamp(time_ns))]
    if step:
        parts += _STEP, _varint(step)
    if observation_digest:
        parts += _OBSERVATION, _sized(observation_digest)
    for field, values in zip(_NUMBERS, numbers, strict=True):
        if values.size:
            parts += field, _sized(values.astype("<f8", copy=False).tobytes())
    if state_digest:
        parts += _STATE, _sized(state_digest)
    return b"".join(parts)


def _sized(data: bytes) -> bytes:
    return _varint(len(data)) + data


@lru_cache(maxsize=1)
def _stamp(time_ns: int) -> bytes:
    return stamp(time_ns).SerializeToString(deterministic=True)


def _varint(value: int) -> bytes:
    digits: list[int] = []
    while value > 0x7F:
        digits.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes((*digits, value))
