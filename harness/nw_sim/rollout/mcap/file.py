"""An MCAP file that is whole or not there, and whose bytes depend on nothing but the trial.

It consists of chunks of messages, then their index (https://mcap.dev/spec). The mcap package knows
the records. Its own writer spends more on one message than a control step of physics costs, and a
log has ten messages in each; here hundreds of them are taken at once.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import IO, Any, Literal

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap_protobuf.schema import build_file_descriptor_set
from numpy.typing import NDArray

from nw_base import __version__
from nw_sim.rollout.mcap.batch import Notes, Part, merged, record, records

Images = Literal["keep", "decide", "drop"]


_Entry = tuple[str, int, type[Any], bytes]
"""Topic, time in ns, protobuf class and content of a message."""
_Image = tuple[str, int, Callable[[], Any]]
"""Topic and time of an image, and the maker of its message if images are kept."""

_MOST_HELD = 64 * 2**20
"""Bytes of a trial's images that wait as they are; what comes later is compressed at once. A policy
with two cameras of 160 x 90 at 10 Hz has 10 MB in 12 s."""

_LONGEST, _LONGEST_WITHOUT_IMAGES = 2.0, 12.0
"""How long messages wait for each other, s of a trial, where nothing else makes them wait. With
images a log is also evidence of what a trial did that killed its process. Without, most trials are
written at once, which takes 0.87 of the time that parts of two seconds take."""
# Small chunks leave much to recover of a log whose process was killed.
CHUNK_BYTES = 512 * 1024

# Level 3, the default, takes 1.4 times as long for 0.96 of the size.
_LEVEL = 1

_MAGIC = b"\x89MCAP0\r\n"
_INDEX = struct.Struct("<BQHI")  # opcode, length; channel, bytes of the pairs that follow
_PAIR = 16  # bytes of a time and a position
_FOOTER = struct.Struct("<BQQQ")  # what the summary's checksum covers of the footer
_MOST_WAITING = 4 * CHUNK_BYTES
"""Bytes of messages that wait for each other where there are no images."""


class McapFile:
    """Writes protobuf messages under `<path>.partial`, which becomes `path` when it is complete.

    With `images="decide"` messages wait in memory, so that those of images can be left out when the
    trial turns out well, and the file is still in order of time. Otherwise they wait until there
    are some hundred, which are made and written together: of a trial whose worker dies
    `mcap recover` saves the whole chunks of the partial file.

    Every method that writes raises OSError when the disk does not take it; `discard` then frees
    what the file holds. The caller decides what a lost log means.
    """

    def __init__(self, path: Path, *, images: Images) -> None:
        self.path = path
        self.partial = path.with_name(path.name + ".partial")
        self._images = images
        self._size = 0  # bytes of messages that wait as they will be written
        self._held = 0  # bytes of images that wait
        self._since = 0.0  # time of the first message that waits, s
        self._pending: list[_Entry | _Image | Notes] = []
        self._channels: dict[str, int] = {}
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        self.partial.unlink(missing_ok=True)  # A link there would be followed.
        self._stream: IO[bytes] = self.partial.open("xb")
        self._writer = McapWriter(self._stream, library=f"nw-eval/{__version__}")

    @property
    def takes_images(self) -> bool:
        """Whether an image that is added now can still end up in the file."""
        return self._images != "drop"

    def add(self, topic: str, time_ns: int, message: Any) -> None:
        """Append one message as it is now; times must not decrease."""
        data = message.SerializeToString(deterministic=True)
        self.add_bytes(topic, time_ns, type(message), data)

    def add_bytes(self, topic: str, time_ns: int, kind: type[Any], data: bytes) -> None:
        """Append a message of one kind that is serialised already."""
        self._size += len(data)
        self._pending.append((topic, time_ns, kind, data))
        if self._images != "decide":
            self._write_if_due(1e-9 * time_ns)

    def add_noted(self, notes: Notes, time: float, *, holds: int = 0) -> None:
        """Append the messages of what was just noted; they are made later.

        Args:
            notes: of which one more was made.
            time: when, s.
            holds: bytes of what it is made from, if that is much.
        """
        self._pending.append(notes)
        self._size += holds
        if self._images != "decide":
            self._write_if_due(time)

    def add_image(
        self, topic: str, time_ns: int, make: Callable[[], Any], *, holds: int = 0
    ) -> None:
        """Append the message that `make` returns, called only if images are kept.

        Args:
            topic: where.
            time_ns: when.
            make: called later, or now where too much would be held until then.
            holds: bytes of what it is made from.
        """
        if self._images == "decide":
            self._held += holds
            if self._held > _MOST_HELD:
                message = make()
                self._pending.append((topic, time_ns, lambda: message))
            else:
                self._pending.append((topic, time_ns, make))
        elif self._images == "keep":
            self.add(topic, time_ns, make())

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Add a record of texts by name."""
        self._writer.metadata(name, values)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Attach a file; it carries no time of day."""
        self._writer.attachment(name, media_type, data)

    def settle(self, *, keep_images: bool) -> None:
        """Write the messages that waited, with or without the images among them."""
        self._images = "keep" if keep_images else "drop"
        self._flush()

    def close(self) -> int:
        """Finish the file, move it into place and return its size in bytes."""
        self._flush()
        self._writer.finish()
        self._stream.close()
        self.partial.replace(self.path)
        return self.path.stat().st_size

    def discard(self) -> None:
        """Remove what was written, as far as the disk lets us; never raises OSError."""
        self._pending.clear()
        with suppress(OSError):
            self._stream.close()  # flushes, which fails again on a full disk
        with suppress(OSError):
            self.partial.unlink(missing_ok=True)

    def _write_if_due(self, time: float) -> None:
        if len(self._pending) == 1:
            self._since = time
        if self._images == "drop":
            longest, most = _LONGEST_WITHOUT_IMAGES, _MOST_WAITING
        else:
            longest, most = _LONGEST, CHUNK_BYTES
        if time - self._since >= longest or self._size > most:
            self._flush()

    def _flush(self) -> None:
        """Write the messages that wait, in their order."""
        waiting, self._pending, self._size = self._pending, [], 0
        noted: dict[Notes, list[int]] = {}  # in which places their messages stand
        alone: list[tuple[int, _Entry]] = []
        for place, entry in enumerate(waiting):
            if not isinstance(entry, tuple):
                noted.setdefault(entry, []).append(place)
            elif len(entry) == 4:
                alone.append((place, entry))
            elif self._images == "keep":
                topic, time_ns, make = entry
                message = make()
                data = message.SerializeToString(deterministic=True)
                alone.append((place, (topic, time_ns, type(message), data)))
        channels = [self._channel(topic, kind) for _, (topic, _, kind, _) in alone]
        data = [entry[3] for _, entry in alone]
        single = records(channels, [entry[1] for _, entry in alone], data)
        parts: list[Part] = [([place for place, _ in alone], single)]
        for notes, places in noted.items():
            for numbers, batch in notes.take(self._channel):
                parts.append(([places[number] for number in numbers], batch))
        self._writer.write(*merged(len(waiting), parts))

    def _channel(self, topic: str, kind: type[Any]) -> int:
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._channels[topic] = self._writer.channel(topic, kind)
        return channel


class McapWriter:
    """Writes to a stream that its caller owns. Every method raises what the stream raises."""

    def __init__(self, stream: IO[bytes], *, library: str) -> None:
        self._stream = stream
        # Zstandard's own sum of a chunk is ten times as fast as MCAP's, which is left out.
        self._compressor = zstandard.ZstdCompressor(level=_LEVEL, write_checksum=True)
        self._schemas: dict[type[Any], bytes] = {}  # Records, by the kind that each is of.
        self._channels: list[bytes] = []
        self._counts: dict[int, int] = {}
        self._chunks: list[ChunkIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._parts: list[bytes] = []  # of the chunk under construction
        self._size = 0  # bytes of them
        self._index: list[NDArray[np.int64]] = []  # channel, time, place in the chunk, (M, 3) each
        stream.write(_MAGIC)
        self._put(Header(profile="", library=library))

    def channel(self, topic: str, kind: type[Any]) -> int:
        """Begin a topic of one kind of protobuf message; return its number."""
        if kind not in self._schemas:
            self._schemas[kind] = _schema(len(self._schemas) + 1, kind)
            self._add(self._schemas[kind])
        number = len(self._channels) + 1
        self._channels.append(_channel(number, topic, list(self._schemas).index(kind) + 1))
        self._add(self._channels[-1])
        return number

    def message(self, channel: int, time_ns: int, data: bytes) -> None:
        """Append a message; times must not decrease."""
        self.write([record(channel, time_ns, data)], np.array([[channel, time_ns, 0, 0]]))

    def write(self, pieces: Sequence[bytes], index: NDArray[np.int64]) -> None:
        """Append records of messages, whose times must not decrease.

        Args:
            pieces: one or more records each.
            index: channel, time (ns), number of its piece and place in it (bytes) of each record in
                the order of the pieces, (M, 4).
        """
        ends = np.cumsum([len(piece) for piece in pieces])
        done, written = 0, 0
        while done < len(pieces):
            # The piece that fills the chunk is the last one in it.
            full = np.searchsorted(ends, CHUNK_BYTES - self._size + written, side="right")
            end = min(int(full) + 1, len(pieces))
            first, last = np.searchsorted(index[:, 2], (done, end))
            entries = index[first:last]
            begins = np.concatenate(([0], ends))[entries[:, 2]] + (self._size - written)
            self._index.append(np.column_stack((entries[:, :2], begins + entries[:, 3])))
            self._parts += pieces[done:end]
            self._size += int(ends[end - 1]) - written
            done, written = end, int(ends[end - 1])
            if self._size > CHUNK_BYTES:
                self._end_chunk()

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a record of texts by name."""
        place, length = self._put(Metadata(name=name, metadata=dict(values)))
        self._metadata.append(MetadataIndex(offset=place, length=length, name=name))

    def attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Add a file; it carries no time of day."""
        attachment = Attachment(
            create_time=0, log_time=0, name=name, media_type=media_type, data=data
        )
        place, length = self._put(attachment)
        self._attachments.append(
            AttachmentIndex(
                offset=place,
                length=length,
                log_time=0,
                create_time=0,
                data_size=len(data),
                name=name,
                media_type=media_type,
            )
        )

    def finish(self) -> None:
        """Write what is left, and the summary by which readers find everything."""
        self._end_chunk()
        self._put(DataEnd(data_section_crc=0))
        start = self._stream.tell()
        groups: tuple[tuple[Opcode, Iterable[bytes]], ...] = (
            (Opcode.SCHEMA, self._schemas.values()),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [_record(self._statistics())]),
            (Opcode.CHUNK_INDEX, map(_record, self._chunks)),
            (Opcode.ATTACHMENT_INDEX, map(_record, self._attachments)),
            (Opcode.METADATA_INDEX, map(_record, self._metadata)),
        )
        summary, offsets = b"", b""
        for opcode, members in groups:
            group = b"".join(members)
            offsets += _record(
                SummaryOffset(
                    group_opcode=opcode,
                    group_start=start + len(summary),
                    group_length=len(group),
                )
            )
            summary += group
        offset_start = start + len(summary)
        summary += offsets
        footer = _FOOTER.pack(Opcode.FOOTER, 20, start, offset_start)
        self._stream.write(summary)
        self._put(
            Footer(
                summary_start=start,
                summary_offset_start=offset_start,
                summary_crc=zlib.crc32(footer, zlib.crc32(summary)),
            )
        )
        self._stream.write(_MAGIC)

    def _add(self, part: bytes) -> None:
        self._parts.append(part)
        self._size += len(part)

    def _end_chunk(self) -> None:
        if not self._index:
            return  # Channels without messages would be a chunk without times.
        data = b"".join(self._parts)
        packed = self._compressor.compress(data)
        index = np.concatenate(self._index)
        first, last = int(index[:, 1].min()), int(index[:, 1].max())
        place, length = self._put(
            Chunk(
                compression="zstd",
                data=packed,
                message_start_time=first,
                message_end_time=last,
                uncompressed_crc=0,
                uncompressed_size=len(data),
            )
        )
        begin = self._stream.tell()
        places = self._put_index(index)
        self._chunks.append(
            ChunkIndex(
                chunk_length=length,
                chunk_start_offset=place,
                compression="zstd",
                compressed_size=len(packed),
                message_start_time=first,
                message_end_time=last,
                message_index_length=self._stream.tell() - begin,
                message_index_offsets=places,
                uncompressed_size=len(data),
            )
        )
        self._parts, self._size, self._index = [], 0, []

    def _put_index(self, index: NDArray[np.int64]) -> dict[int, int]:
        """Write where each channel's messages are in a chunk; return where that is written."""
        index = index[np.argsort(index[:, 0], kind="stable")]
        channels = index[:, 0]
        starts = [0, *(np.flatnonzero(channels[1:] != channels[:-1]) + 1).tolist()]
        pairs = index[:, 1:].astype("<u8").tobytes()
        place = self._stream.tell()
        places: dict[int, int] = {}
        for start, end in pairwise([*starts, len(index)]):
            channel, data = int(channels[start]), pairs[_PAIR * start : _PAIR * end]
            head = _INDEX.pack(Opcode.MESSAGE_INDEX, 6 + len(data), channel, len(data))
            self._stream.write(head + data)
            places[channel] = place
            place += len(head) + len(data)
            self._counts[channel] = self._counts.get(channel, 0) + end - start
        return places

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            message_end_time=max((chunk.message_end_time for chunk in self._chunks), default=0),
            message_start_time=min((chunk.message_start_time for chunk in self._chunks), default=0),
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )

    def _put(self, record: McapRecord) -> tuple[int, int]:
        """Write a record that is in no chunk; return its place and length in bytes."""
        place, data = self._stream.tell(), _record(record)
        self._stream.write(data)
        return place, len(data)


def _record(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


# The logs of a policy's trials have the same schemas and channels.
@lru_cache(maxsize=256)
def _schema(number: int, kind: type[Any]) -> bytes:
    """Return the record of a kind of message, with all that it is made of."""
    data = build_file_descriptor_set(kind).SerializeToString(deterministic=True)
    name = kind.DESCRIPTOR.full_name
    return _record(Schema(id=number, name=name, encoding="protobuf", data=data))


@lru_cache(maxsize=1024)
def _channel(number: int, topic: str, schema: int) -> bytes:
    channel = Channel(
        id=number, topic=topic, message_encoding="protobuf", metadata={}, schema_id=schema
    )
    return _record(channel)
