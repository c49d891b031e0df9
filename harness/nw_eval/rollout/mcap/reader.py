"""Reads a trial's log back: its texts, its states, its pictures and where everything was."""

from __future__ import annotations

import stat
import struct
from contextlib import contextmanager
from typing import IO, TYPE_CHECKING, Any

import numpy as np
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
from mcap.exceptions import McapError
from zstandard import ZstdError

from nw_eval.clean import clean
from nw_eval.errors import StoreError
from nw_eval.rollout.mcap.images import image_of, values_of
from nw_eval.rollout.mcap.messages import (
    Command,
    Event,
    Observation,
    PolicyStep,
    SimState,
    Twist,
)
from nw_eval.rollout.mcap.records import MOST_MESSAGE, LoggedMessage, attached, logged, texts
from nw_eval.rollout.mcap.topics import ELEMENTS

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator, Mapping
    from pathlib import Path

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
_DAMAGE = (
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
        found = self.metadata().get(ELEMENTS, {})
        return {topic: tuple(names.split(",")) for topic, names in found.items()}

    def attachments(self) -> dict[str, bytes]:
        """Return attached files by name, such as `suite.yaml`."""
        with self._open() as stream:
            found: dict[str, bytes] = {}
            for record in attached(stream):
                found[record.name] = record.data
                _bound(sum(map(len, found.values())))
            return found

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
        found: list[Any] = []
        total = 0
        with self._open() as stream:
            for message in logged(stream, ("/nw/state",)):
                _bound(total := total + len(message.data))
                found.append(SimState.FromString(message.data))
        return tuple(found)

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
        """Yield (time in s, float32 array) of an observation that is no picture, when new."""
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
        except _DAMAGE as error:
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
