"""Reads a log back: its records, and of a trial texts, states, pictures and where everything was.

A log may be damaged or untrusted. Records come in their order, each bounded before it is read or
unpacked: nothing here follows an offset that the file gives, every byte is met once, and a chunk is
unpacked only after what it says of its size was believed possible. The format is
https://mcap.dev/spec.
"""

from __future__ import annotations

import os
import stat
import struct
import zlib
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from typing import IO, TYPE_CHECKING, Any

import lz4.frame
import numpy as np
import zstandard
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.message import DecodeError
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Metadata, Schema
from zstandard import ZstdError

from nw_base.clean import clean
from nw_base.errors import StoreError
from nw_sim.rollout.mcap.images import image_of, values_of
from nw_sim.rollout.mcap.messages import (
    Command,
    Event,
    Observation,
    PolicyStep,
    SimState,
    Twist,
)
from nw_sim.rollout.mcap.topics import ELEMENTS

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator, Mapping
    from pathlib import Path


MOST_MESSAGE = 16 * 2**20
"""Bytes of a message that is decoded; a policy's memory of pictures has some millions."""

_MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")  # opcode, length
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time; then the data
_ID, _IDS, _LENGTH = struct.Struct("<H"), struct.Struct("<HH"), struct.Struct("<I")
_IN_CHUNKS = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE})
_MOST_NAME = 1000  # bytes
_MOST_TEXTS = 4 * 2**20  # bytes of all records of texts; a trial has some thousand
_MOST_RECORDS = 1_000_000  # Ten minutes at 50 Hz have a quarter of this.
_MOST_FOREIGN = 20_000_000  # An hour of ten topics at 500 Hz.
_MOST_RECORD = 64 * 2**20  # bytes, packed or unpacked; a chunk of ours has half a million
_MOST_UNPACKED = 4 * 2**30  # bytes of all chunks
_MOST_RATIO, _FREE = 200, 2**20  # unpacked to packed bytes of a chunk; smaller ones may exceed it


@dataclass(frozen=True, kw_only=True)
class LoggedMessage:
    """One message as it lies in the file."""

    topic: str
    kind: str  # the name of its schema
    time_ns: int
    data: bytes


@dataclass(frozen=True, kw_only=True)
class ForeignMessage:
    """One message of a log of another program, as it lies in the file."""

    topic: str
    encoding: str  # of the message, such as `cdr`
    schema: Schema | None
    time_ns: int
    data: bytes


class CompressionError(ValueError):
    """A chunk is whole, and compressed in a way that is not read here."""


class _Exact(ReadDataStream):
    """A record's content, which must be as long as it says."""

    def read(self, length: int) -> bytes:
        data = super().read(length) if length > 0 else b""
        if len(data) != length:
            raise ValueError("a record is cut off")
        return data


def texts(stream: IO[bytes]) -> Iterator[Metadata]:
    """Yield the records of texts.

    Raises:
        ValueError, EOFError, struct.error, mcap's errors: the file is damaged or no log.
    """
    total = 0
    for _, data in _records(stream, {Opcode.METADATA}):
        total += len(data)
        if total > _MOST_TEXTS:
            raise ValueError(f"it has over {_MOST_TEXTS // 2**20} MiB of texts")
        yield Metadata.read(_Exact(BytesIO(data)))


def attached(stream: IO[bytes]) -> Iterator[Attachment]:
    """Yield the attached files; raises as `texts`."""
    for _, data in _records(stream, {Opcode.ATTACHMENT}):
        yield Attachment.read(_Exact(BytesIO(data)))


def logged(stream: IO[bytes], topics: Collection[str] = ()) -> Iterator[LoggedMessage]:
    """Yield the messages of some topics, of all if none is named; raises as `texts`.

    Raises:
        ValueError: also if they are not in order of time.
    """
    kinds: dict[int, str] = {0: ""}
    channels: dict[int, tuple[str, str]] = {}
    latest, count = 0, 0
    for part in _parts(stream):
        # A log has thousands of messages for one that is wanted: none is cut out to be looked at.
        start, end = 0, len(part)
        while start < end:
            opcode, length = _HEAD.unpack_from(part, start)
            start += _HEAD.size
            count += 1
            if length > end - start or count > _MOST_RECORDS:
                raise ValueError("a chunk has more in it than it can have")
            if opcode == Opcode.MESSAGE:
                if length < _MESSAGE.size:
                    raise ValueError("a message is cut off")
                number, _, time_ns, _ = _MESSAGE.unpack_from(part, start)
                if number not in channels:
                    raise ValueError("a message has no channel")
                if time_ns < latest:
                    raise ValueError("its messages are not in order of time")
                latest = time_ns
                topic, kind = channels[number]
                if not topics or topic in topics:
                    data = part[start + _MESSAGE.size : start + length]
                    yield LoggedMessage(topic=topic, kind=kind, time_ns=time_ns, data=data)
            elif opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
                _learn(opcode, part[start : start + length], kinds, channels)
            start += length


def foreign(stream: IO[bytes]) -> Iterator[ForeignMessage]:
    """Yield the messages of any program's log, in the order of the file; raises as `texts`."""
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    count = 0
    for part in _parts(stream):
        start, end = 0, len(part)
        while start < end:
            opcode, length = _HEAD.unpack_from(part, start)
            start += _HEAD.size
            count += 1
            if length > end - start or count > _MOST_FOREIGN:
                raise ValueError("a chunk has more in it than it can have")
            if opcode == Opcode.MESSAGE:
                if length < _MESSAGE.size:
                    raise ValueError("a message is cut off")
                number, _, time_ns, _ = _MESSAGE.unpack_from(part, start)
                if number not in channels:
                    raise ValueError("a message has no channel")
                channel = channels[number]
                yield ForeignMessage(
                    topic=channel.topic,
                    encoding=channel.message_encoding,
                    schema=schemas.get(channel.schema_id),
                    time_ns=time_ns,
                    data=part[start + _MESSAGE.size : start + length],
                )
            elif opcode == Opcode.SCHEMA:
                schema = Schema.read(_Exact(BytesIO(part[start : start + length])))
                schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(_Exact(BytesIO(part[start : start + length])))
                channels[channel.id] = channel
            start += length


def _learn(
    opcode: int, data: bytes, kinds: dict[int, str], channels: dict[int, tuple[str, str]]
) -> None:
    """Add what a record says of a schema, or of a channel: its topic and kind."""
    if opcode == Opcode.SCHEMA:
        kinds[_ID.unpack_from(data)[0]] = _name(data, _ID.size)
        return
    number, schema = _IDS.unpack_from(data)
    if schema not in kinds:
        raise ValueError("a channel has no schema")
    channels[number] = (_name(data, _IDS.size), kinds[schema])


def _parts(stream: IO[bytes]) -> Iterator[bytes]:
    """Yield schemas, channels and messages with their heads: all of a chunk's, or one in none."""
    unpacked = 0
    for opcode, data in _records(stream, {*_IN_CHUNKS, Opcode.CHUNK}):
        if opcode != Opcode.CHUNK:
            yield _HEAD.pack(opcode, len(data)) + data
            continue
        inside = _unpacked(Chunk.read(_Exact(BytesIO(data))))
        unpacked += len(inside)
        if unpacked > _MOST_UNPACKED:
            raise ValueError(f"it unpacks to over {_MOST_UNPACKED // 2**30} GiB")
        yield inside


def _name(data: bytes, start: int) -> str:
    """Return the text that starts there with its length."""
    (length,) = _LENGTH.unpack_from(data, start)
    start += _LENGTH.size
    if length > min(_MOST_NAME, len(data) - start):
        raise ValueError("a name is too long")
    return data[start : start + length].decode()


def _unpacked(chunk: Chunk) -> bytes:
    """Return what a chunk holds."""
    size, packed = chunk.uncompressed_size, len(chunk.data)
    if size > _MOST_RECORD or size > max(_MOST_RATIO * packed, _FREE):
        raise ValueError(f"a chunk of {packed} bytes unpacks to {size}")
    if chunk.compression not in {"", "zstd", "lz4"}:
        kind = chunk.compression[:20]
        raise CompressionError(f"a chunk is compressed by {kind!r}, not zstd or lz4")
    data = chunk.data
    if chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size) if size else b""
    elif chunk.compression:
        # zstd believes a frame's own word for its size, whatever limit one gives.
        if zstandard.frame_content_size(data) not in {-1, size}:
            raise ValueError("a chunk's size is not the one in its header")
        data = zstandard.ZstdDecompressor().decompress(data, max_output_size=size) if size else b""
    if len(data) != size:
        raise ValueError("a chunk's size is not the one in its header")
    if chunk.uncompressed_crc not in {0, zlib.crc32(data)}:
        raise ValueError("a chunk's checksum is that of other bytes")
    return data


def _records(stream: IO[bytes], wanted: Collection[int]) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and content of the data section's records that are wanted."""
    end = stream.seek(0, os.SEEK_END)
    if end >= 2 * len(_MAGIC):
        stream.seek(-len(_MAGIC), os.SEEK_END)
    if stream.read(len(_MAGIC)) != _MAGIC:
        raise ValueError("it is cut off, or not an MCAP file")
    stream.seek(0)
    if stream.read(len(_MAGIC)) != _MAGIC:
        raise ValueError("it is not an MCAP file")
    for _ in range(_MOST_RECORDS):
        opcode, length = _HEAD.unpack(stream.read(_HEAD.size))
        if length > end - stream.tell():
            raise ValueError("a record is longer than the file")
        if opcode in {Opcode.DATA_END, Opcode.FOOTER}:
            return
        if opcode not in wanted:
            stream.seek(length, os.SEEK_CUR)
            continue
        if length > _MOST_RECORD:
            raise ValueError(f"a record has over {_MOST_RECORD // 2**20} MiB")
        yield opcode, stream.read(length)
    raise ValueError(f"it has over {_MOST_RECORDS} records")


Pose = tuple[np.ndarray, np.ndarray]

_WRITTEN: tuple[Any, ...] = (
    CameraCalibration,
    Command,
    CompressedImage,
    Event,
    FrameTransforms,
    JointStates,
    Log,
    Observation,
    PointCloud,
    PolicyStep,
    PoseInFrame,
    RawImage,
    SceneUpdate,
    SimState,
    Twist,
)
_KINDS: dict[str, Any] = {kind.DESCRIPTOR.full_name: kind for kind in _WRITTEN}
"""What logs hold, by name. A log's own schemas are for other programs and are not used here."""

_MOST_KEPT = 256 * 2**20  # bytes of texts, attachments or states that are returned at once
# What a damaged file may cause in the libraries that read it.
DAMAGE = (
    ArithmeticError,
    AttributeError,
    DecodeError,
    EOFError,
    LookupError,
    McapError,
    MemoryError,
    RuntimeError,
    TypeError,
    ValueError,
    ZstdError,
    struct.error,
)


class LogReader:
    """A finished log. Every method opens the file anew, so readers hold nothing.

    Raises:
        StoreError: (every method) the file is missing, cut off, damaged or no log.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def metadata(self) -> dict[str, dict[str, str]]:
        """Return the records of texts by name, such as `nw.trial` and `nw.verdict`."""
        with self._open() as stream:
            return {record.name: dict(record.metadata) for record in texts(stream)}

    def elements(self) -> dict[str, tuple[str, ...]]:
        """Return what numbers are called, by topic, or topic and field; older logs do not say."""
        by_topic = self.metadata().get(ELEMENTS, {})
        return {topic: tuple(names.split(",")) for topic, names in by_topic.items()}

    def attachments(self) -> dict[str, bytes]:
        """Return attached files by name, such as `suite.yaml`."""
        with self._open() as stream:
            attachments: dict[str, bytes] = {}
            for record in attached(stream):
                attachments[record.name] = record.data
                _bound(sum(map(len, attachments.values())))
            return attachments

    def topics(self) -> dict[str, int]:
        """Return the number of messages of every topic."""
        counts: dict[str, int] = {}
        with self._open() as stream:
            for message in logged(stream):
                counts[message.topic] = counts.get(message.topic, 0) + 1
        return counts

    def messages(self, *topics: str) -> Iterator[tuple[str, int, Any]]:
        """Yield (topic, time in ns, decoded message) in order of time; all topics if none named."""
        with self._open() as stream:
            for message in logged(stream, topics):
                yield message.topic, message.time_ns, _decoded(message)

    def states(self) -> tuple[Any, ...]:
        """Return the restartable states (`nw.SimState`), oldest first."""
        states: list[Any] = []
        total = 0
        with self._open() as stream:
            for message in logged(stream, ("/nw/state",)):
                _bound(total := total + len(message.data))
                states.append(SimState.FromString(message.data))
        return tuple(states)

    def frames(self, camera: str = "ego") -> Iterator[tuple[float, np.ndarray]]:
        """Yield (time in s, image) of a camera's pictures; none if they were not kept.

        Images are (H, W, 3) uint8 photographs, (H, W) uint8 of grey or classes, or (H, W) float32:
        metres, 0 where there are none, or the numbers that the policy was given.

        Args:
            camera: what stands behind `/camera/`, such as `ego` or `ego/depth`.
        """
        for _, time_ns, message in self.messages(f"/camera/{camera}"):
            with self._damage_is_an_error():
                frame = image_of(message)
            yield time_ns * 1e-9, frame

    def observations(self, name: str) -> Iterator[tuple[float, np.ndarray]]:
        """Yield (time in s, float32 array) of an observation that is not a picture, when new."""
        for _, time_ns, message in self.messages(f"/observation/{name}"):
            with self._damage_is_an_error():
                values = values_of(message)
            yield time_ns * 1e-9, values

    def poses(self) -> Iterator[tuple[float, Mapping[str, Pose]]]:
        """Yield (time in s, frame name to position (3,) m and quaternion wxyz in the world)."""
        for _, time_ns, message in self.messages("/tf"):
            with self._damage_is_an_error():
                poses: dict[str, Pose] = {}
                for entry in message.transforms:
                    p, q = entry.translation, entry.rotation
                    poses[entry.child_frame_id] = (
                        np.array([p.x, p.y, p.z]),
                        np.array([q.w, q.x, q.y, q.z]),
                    )
            yield time_ns * 1e-9, poses

    @contextmanager
    def _open(self) -> Generator[IO[bytes]]:
        with self._damage_is_an_error():
            # A pipe or a device may never end, and a pipe may never begin.
            if not stat.S_ISREG(self.path.stat().st_mode):
                raise ValueError("it is not a file")
            with self.path.open("rb") as stream:
                yield stream

    @contextmanager
    def _damage_is_an_error(self) -> Generator[None]:
        try:
            yield
        except OSError as error:
            raise StoreError(
                f"cannot read {self.path}: {error.strerror or clean(error)}", fix="check the path"
            ) from error
        except DAMAGE as error:
            reason = clean(error, at_most=200) or type(error).__name__
            raise StoreError(
                f"{self.path} is damaged, or not a log of nw-eval: {reason}",
                fix="run the trial again, or save what is left with `mcap recover`",
            ) from error


def _decoded(message: LoggedMessage) -> Any:
    kind = _KINDS.get(message.kind)
    if kind is None:
        raise ValueError(f"{clean(message.topic, at_most=60)} has messages of an unknown kind")
    if len(message.data) > MOST_MESSAGE:
        raise ValueError(f"a message has over {MOST_MESSAGE // 2**20} MiB")
    return kind.FromString(message.data)


def _bound(size: int) -> None:
    if size > _MOST_KEPT:
        raise ValueError(f"it has over {_MOST_KEPT // 2**20} MiB of states or attachments")
