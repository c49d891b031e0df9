"""Times of a log: simulated time since the trial's start, never the time of day."""

from __future__ import annotations

from google.protobuf.timestamp_pb2 import Timestamp

_SECOND = 1_000_000_000


def nanoseconds(seconds: float) -> int:
    """Return simulated seconds as whole nanoseconds."""
    return round(seconds * _SECOND)


def stamp(time_ns: int) -> Timestamp:
    """Return nanoseconds as protobuf's timestamp."""
    return Timestamp(seconds=time_ns // _SECOND, nanos=time_ns % _SECOND)
