"""The protobuf messages that Foxglove has no schema for: what a policy saw and said, and states.

Built from a table at import, so that no generated file and no protoc are needed. Field numbers are
a promise to every log ever written: append, never renumber.

Below are the parts of the wire format (https://protobuf.dev/programming-guides/encoding) that are
put together by hand, for messages that are written in every control step, or of which all but the
time is known before. Times of a log are simulated time since the trial's start, never the time of
day.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, NamedTuple

from foxglove_schemas_protobuf import Vector3_pb2
from google.protobuf import descriptor_pool, timestamp_pb2
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto
from google.protobuf.message_factory import GetMessageClass
from google.protobuf.timestamp_pb2 import Timestamp

from nw_sim.rollout.mcap.batch import Channels, Part, records

_Field = FieldDescriptorProto
_TYPES = {
    "bytes": _Field.TYPE_BYTES,
    "double": _Field.TYPE_DOUBLE,
    "float": _Field.TYPE_FLOAT,
    "string": _Field.TYPE_STRING,
    "uint32": _Field.TYPE_UINT32,
    "int32": _Field.TYPE_INT32,
}

# (name, type); a type in brackets is repeated, one with a dot is a message.
_MESSAGES: dict[str, tuple[tuple[str, str], ...]] = {
    # What the policy said, and what was applied (which lags by the action delay).
    "PolicyStep": (
        ("timestamp", "google.protobuf.Timestamp"),
        ("step", "uint32"),
        ("observation_digest", "bytes"),  # SHA-256 over the observations, names in order
        ("action", "[double]"),  # raw output, (12)
        ("applied", "[double]"),  # raw action applied in this step, (12)
        ("targets", "[double]"),  # joint targets of this step, rad, (12)
        (
            "state_digest",
            "bytes",
        ),  # SHA-256 of the policy's memory, where /nw/state has it
    ),
    "Part": (("name", "string"), ("data", "bytes")),
    # Everything that a trial needs to go on from a control step to the same end, bit for bit.
    "SimState": (
        ("timestamp", "google.protobuf.Timestamp"),
        ("step", "uint32"),  # control steps done
        ("world", "bytes"),  # sim.World.state()
        ("policy", "bytes"),  # Policy.state()
        ("parts", "[nw.Part]"),  # trail, termination, delay queue, sensors, digests, by name
    ),
    # Numbers that the policy was given, by the terms of the card where it has some.
    "Observation": (
        ("timestamp", "google.protobuf.Timestamp"),
        ("shape", "[uint32]"),
        ("terms", "[nw.Term]"),  # all values in a row are the observation, last axis fastest
    ),
    "Term": (("name", "string"), ("values", "[float]")),
    # Velocity of the trunk's origin, m/s, and angular velocity, rad/s.
    "Twist": (
        ("timestamp", "google.protobuf.Timestamp"),
        ("frame_id", "string"),
        ("linear", "foxglove.Vector3"),
        ("angular", "foxglove.Vector3"),
    ),
    # What the card's `command` asks for; the frame is the trunk's, level.
    "Command": (
        ("timestamp", "google.protobuf.Timestamp"),
        ("frame_id", "string"),
        ("forward", "double"),  # m/s
        ("left", "double"),  # m/s
        ("yaw_rate", "double"),  # rad/s
        ("heading_error", "double"),  # rad from the heading to the next waypoint, to the left
    ),
    "Event": (
        ("timestamp", "google.protobuf.Timestamp"),
        ("step", "uint32"),
        ("kind", "string"),  # see trial_log.EventKind
        ("text", "string"),
        ("waypoint", "int32"),  # number of the waypoint reached, from 0; -1 = none
        ("value", "double"),
    ),
}
_SECOND = 1_000_000_000
_FIRST = b"\x0a"  # field 1, of a length that is said


def _file() -> FileDescriptorProto:
    file = FileDescriptorProto(name="nw/messages.proto", package="nw", syntax="proto3")
    file.dependency.extend([timestamp_pb2.DESCRIPTOR.name, Vector3_pb2.DESCRIPTOR.name])
    for name, fields in _MESSAGES.items():
        message = file.message_type.add(name=name)
        for number, (field, written) in enumerate(fields, start=1):
            kind = written.strip("[]")
            added = message.field.add(
                name=field,
                number=number,
                label=_Field.LABEL_REPEATED if written != kind else _Field.LABEL_OPTIONAL,
                type=_TYPES.get(kind, _Field.TYPE_MESSAGE),
            )
            if kind not in _TYPES:
                added.type_name = f".{kind}"
    return file


def _classes() -> dict[str, Any]:
    pool = descriptor_pool.Default()
    pool.AddSerializedFile(_file().SerializeToString())
    return {name: GetMessageClass(pool.FindMessageTypeByName(f"nw.{name}")) for name in _MESSAGES}


_BUILT = _classes()
PolicyStep: Any = _BUILT["PolicyStep"]
StatePart: Any = _BUILT["Part"]
SimState: Any = _BUILT["SimState"]
Event: Any = _BUILT["Event"]
Observation: Any = _BUILT["Observation"]
Term: Any = _BUILT["Term"]
Twist: Any = _BUILT["Twist"]
Command: Any = _BUILT["Command"]


def nanoseconds(seconds: float) -> int:
    """Return simulated seconds as whole nanoseconds."""
    return round(seconds * _SECOND)


def stamp(time_ns: int) -> Timestamp:
    """Return nanoseconds as protobuf's timestamp."""
    return Timestamp(seconds=time_ns // _SECOND, nanos=time_ns % _SECOND)


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


# Fields of `SimState` and of its `Part`s, as in `messages._MESSAGES`.
_STEP, _WORLD, _POLICY, _PART = b"\x10", b"\x1a", b"\x22", b"\x2a"
_NAME, _DATA = b"\x0a", b"\x12"
# Bytes before the data of a part at most, beside its name.
_MOST_HEAD = 24


class Saved(NamedTuple):
    """What a trial needs to go on from a control step; see `messages` for each."""

    step: int
    world: bytes
    policy: bytes
    parts: Mapping[str, bytes]

    @property
    def size(self) -> int:
        """Bytes of the data in it."""
        return len(self.world) + len(self.policy) + sum(map(len, self.parts.values()))

    def exceeds(self, size: int) -> bool:
        """Whether its message has more bytes than that without a time, counted where it may."""
        heads = 4 * sum(map(len, self.parts)) + _MOST_HEAD * (len(self.parts) + 3)
        return self.size + heads > size and len(sim_state(self)) > size


def sim_state(saved: Saved) -> bytes:
    """Return the message without its time; what is zero or empty is left out, as protobuf does."""
    chunks: list[bytes] = []
    if saved.step:
        chunks += _STEP, varint(saved.step)
    for field, data in ((_WORLD, saved.world), (_POLICY, saved.policy)):
        if data:
            chunks += field, sized(data)
    for name, data in saved.parts.items():
        chunks += _part_head(name, len(data)), data
    return b"".join(chunks)


@lru_cache(maxsize=1024)  # They are the same in most states.
def _part_head(name: str, size: int) -> bytes:
    """Return what stands before the data of a part."""
    head = _NAME + sized(name.encode()) if name else b""
    if size:
        head += _DATA + varint(size)
    return _PART + varint(len(head) + size) + head


class States:
    """Notes of restartable states."""

    def __init__(self) -> None:
        self._notes: list[tuple[int, Saved]] = []

    def note(self, time_ns: int, saved: Saved) -> None:
        """Keep a state."""
        self._notes.append((time_ns, saved))

    def take(self, channels: Channels) -> list[Part]:
        """Return the messages of all notes so far, and forget them."""
        notes, self._notes = self._notes, []
        times = [time_ns for time_ns, _ in notes]
        messages = (time_field(time_ns) + sim_state(saved) for time_ns, saved in notes)
        numbers = [channels("/nw/state", SimState)] * len(notes)
        return [(range(len(notes)), records(numbers, times, messages))]
