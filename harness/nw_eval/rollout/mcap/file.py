"""An MCAP file that is whole or not there, and whose bytes depend on nothing but the trial."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, Literal

from nw_eval import __version__
from nw_eval.rollout.mcap.batch import Notes, Part, merged, records
from nw_eval.rollout.mcap.writer import CHUNK_BYTES, McapWriter

Images = Literal["keep", "decide", "drop"]


_Entry = tuple[str, int, type[Any], bytes]
"""Topic, time in ns, protobuf class and content of a message."""
_Image = tuple[str, int, Callable[[], Any]]
"""Topic and time of an image, and what makes its message if images are kept."""

_MOST_HELD = 64 * 2**20
"""Bytes of a trial's images that wait as they are; what comes later is compressed at once. A policy
with two cameras of 160 x 90 at 10 Hz has 10 MB in 12 s."""

_LONGEST, _LONGEST_WITHOUT_IMAGES = 2.0, 12.0
"""How long messages wait for each other, s of a trial, where nothing else makes them wait. With
images a log is also evidence of what a trial did that killed its process. Without, most trials are
written at once, which takes 0.87 of the time that parts of two seconds take."""

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
