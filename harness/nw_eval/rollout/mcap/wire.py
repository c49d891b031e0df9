"""Protobuf's wire format by hand (https://protobuf.dev/programming-guides/encoding).

For messages that are written in every control step, or of which all but the time is known before.
"""

from __future__ import annotations

from functools import lru_cache

from nw_eval.rollout.mcap.stamps import stamp

_FIRST = b"\x0a"  # field 1, of a length that is said


@lru_cache(maxsize=4096)  # Most are lengths, and the same from message to message.
def varint(value: int) -> bytes:
    """Return a number, at least 0, as a varint."""
    digits: list[int] = []
    while value > 0x7F:
        digits.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes((*digits, value))


def sized(data: bytes) -> bytes:
    """Return data behind its length."""
    return varint(len(data)) + data


@lru_cache(maxsize=4096)
def time_field(time_ns: int) -> bytes:
    """Return the timestamp that is field 1 of all our messages, as of Foxglove's."""
    return _FIRST + sized(stamp(time_ns).SerializeToString(deterministic=True))
