"""Reads a trial's log back: its texts, its states, its pictures and where everything was."""

from __future__ import annotations

from contextlib import contextmanager
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import McapReader, make_reader
from mcap_protobuf.decoder import DecoderFactory
from PIL import Image as PillowImage

from nw_eval.errors import StoreError
from nw_eval.rollout.mcap.messages import SimState

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator, Mapping
    from pathlib import Path

Pose = tuple[np.ndarray, np.ndarray]


class LogReader:
    """A finished log. Every method opens the file anew, so readers hold nothing.

    Raises:
        StoreError: (every method) the file is missing, cut off or no log.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def metadata(self) -> dict[str, dict[str, str]]:
        """Return the records of texts by name, such as `nw.trial` and `nw.verdict`."""
        with self._open() as reader:
            return {record.name: dict(record.metadata) for record in reader.iter_metadata()}

    def attachments(self) -> dict[str, bytes]:
        """Return attached files by name, such as `suite.yaml`."""
        with self._open() as reader:
            return {record.name: record.data for record in reader.iter_attachments()}

    def topics(self) -> dict[str, int]:
        """Return the number of messages of every topic."""
        with self._open() as reader:
            summary = reader.get_summary()
            if summary is None or summary.statistics is None:
                raise StoreError(f"{self.path} has no summary", fix="run `mcap recover` on it")
            counts = summary.statistics.channel_message_counts
            return {c.topic: counts.get(c.id, 0) for c in summary.channels.values()}

    def messages(self, *topics: str) -> Iterator[tuple[str, int, Any]]:
        """Yield (topic, time in ns, decoded message) in order of time; all topics if none named."""
        with self._open() as reader:
            for decoded in reader.iter_decoded_messages(topics=topics or None):
                yield (
                    decoded.channel.topic,
                    decoded.message.log_time,
                    decoded.decoded_message,
                )

    def states(self) -> tuple[Any, ...]:
        """Return the restartable states (`nw.SimState`), oldest first."""
        with self._open() as reader:
            found = reader.iter_messages(topics=["/nw/state"])
            return tuple(SimState.FromString(message.data) for _, _, message in found)

    def frames(self, camera: str = "ego") -> Iterator[tuple[float, np.ndarray]]:
        """Yield (time in s, image (H, W, 3) uint8) of a camera; none if they were not kept."""
        for _, time_ns, message in self.messages(f"/camera/{camera}"):
            with PillowImage.open(BytesIO(message.data)) as image:
                yield time_ns * 1e-9, np.asarray(image.convert("RGB"))

    def poses(self) -> Iterator[tuple[float, Mapping[str, Pose]]]:
        """Yield (time in s, frame name to position (3,) m and quaternion wxyz in the world)."""
        for _, time_ns, message in self.messages("/tf"):
            poses: dict[str, Pose] = {}
            for entry in message.transforms:
                p, q = entry.translation, entry.rotation
                poses[entry.child_frame_id] = (
                    np.array([p.x, p.y, p.z]),
                    np.array([q.w, q.x, q.y, q.z]),
                )
            yield time_ns * 1e-9, poses

    @contextmanager
    def _open(self) -> Generator[McapReader]:
        try:
            with self.path.open("rb") as stream:
                yield make_reader(stream, decoder_factories=[DecoderFactory()])
        except OSError as error:
            raise StoreError(
                f"cannot read {self.path}: {error.strerror or error}", fix="check the path"
            ) from error
        except (McapError, ValueError, EOFError) as error:
            raise StoreError(
                f"{self.path} is damaged or no log of nw-eval: {error}",
                fix="run the trial again, or save what is left with `mcap recover`",
            ) from error
