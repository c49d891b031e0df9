"""The latest pictures among a log's messages, and what they show."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np

from nw_eval.api.running.evidence.clip import PERIOD, SECONDS, sized

if TYPE_CHECKING:
    from PIL.Image import Image

    from nw_eval.rollout.mcap.records import LoggedMessage

_PHOTO, _RAW = "foxglove.CompressedImage", "foxglove.RawImage"
_RAW_KINDS = {"16UC1": np.dtype("<u2"), "32FC1": np.dtype("<f4")}
_MOST_KEPT = 64 * 2**20  # bytes of pictures of all cameras that wait for a trial's end
_MOST_PIXELS = 4096 * 4096
_FAR = 30.0  # The grey of what is farthest; only what is nothing is black.
_SECOND = 1e-9  # in a nanosecond


class LatestPictures:
    """Remembers the pictures of the last seconds, camera by camera."""

    def __init__(self) -> None:
        self._kept: dict[tuple[str, str], deque[LoggedMessage]] = {}
        self._bytes = 0

    def take(self, message: LoggedMessage) -> None:
        """Remember a message, if it is a picture, and forget those for which there is no room."""
        if message.kind not in {_PHOTO, _RAW} or not message.topic.startswith("/camera/"):
            return
        self._kept.setdefault((message.kind, message.topic), deque()).append(message)
        self._bytes += len(message.data)
        self._forget(message.time_ns)

    def shown(self, end_ns: int) -> tuple[str, list[tuple[float, Image]]]:
        """Return a topic and its (seconds, picture) until the trial's end; none if there are none.

        Of several cameras a photograph goes before depth, and what has the shorter name first.

        Raises:
            ValueError, OSError, protobuf's errors: a picture is damaged.
        """
        self._forget(end_ns)
        found = [key for key, messages in self._kept.items() if messages]
        if not found:
            return "", []
        kind, topic = min(found, key=lambda key: (key[0], key[1].count("/"), key[1]))
        messages = _thinned(self._kept[kind, topic])
        times = [message.time_ns * _SECOND for message in messages]
        data = [message.data for message in messages]
        pictures = [_photo(each) for each in data] if kind == _PHOTO else _greys(data)
        return topic, list(zip(times, pictures, strict=True))

    def _forget(self, now_ns: int) -> None:
        for messages in self._kept.values():
            while messages and (
                (now_ns - messages[0].time_ns) * _SECOND > SECONDS or self._bytes > _MOST_KEPT
            ):
                self._bytes -= len(messages.popleft().data)


def _thinned(messages: deque[LoggedMessage]) -> list[LoggedMessage]:
    """Return messages that are some time apart, the last of all among them."""
    kept = [messages[-1]]
    for message in reversed(messages):
        if (kept[-1].time_ns - message.time_ns) * _SECOND > 0.99 * PERIOD:
            kept.append(message)
    return kept[::-1]


def _photo(data: bytes) -> Image:
    from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

    from nw_eval.files.pictures import open_picture

    message = CompressedImage.FromString(data)
    with open_picture(BytesIO(message.data), ("JPEG", "PNG")) as picture:
        _bound(picture.width, picture.height)
        return sized(picture)


def _greys(data: Sequence[bytes]) -> list[Image]:
    """Return pictures of numbers: what is small, or near, is bright, and what is none is black."""
    from PIL.Image import fromarray

    arrays = [_numbers(each) for each in data]
    known = np.concatenate([array[np.isfinite(array)] for array in arrays])
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    pictures: list[Image] = []
    for array in arrays:
        near = ((high - array) / max(high - low, 1e-12)).clip(0.0, 1.0)
        grey = np.where(np.isfinite(array), _FAR + (255.0 - _FAR) * near, 0.0)
        pictures.append(sized(fromarray(np.rint(grey).astype(np.uint8))))
    return pictures


def _numbers(data: bytes) -> Any:
    """Return a picture of numbers, (H, W) float64: metres where it is of depth, NaN for none."""
    from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

    message = RawImage.FromString(data)
    _bound(message.width, message.height)
    kind = _RAW_KINDS.get(message.encoding)
    if kind is None or len(message.data) != message.width * message.height * kind.itemsize:
        raise ValueError("a picture is damaged")
    numbers = np.frombuffer(message.data, kind).reshape(message.height, message.width)
    numbers = numbers.astype(np.float64)
    return np.where(numbers > 0, numbers, np.nan) if message.encoding == "16UC1" else numbers


def _bound(width: int, height: int) -> None:
    if not 0 < width * height <= _MOST_PIXELS:
        raise ValueError(f"a picture has {width} x {height} pixels")
