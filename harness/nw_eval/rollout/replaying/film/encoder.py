"""Pictures into an MP4 file, by PyAV: its wheels carry their own FFmpeg, and need no other."""

from __future__ import annotations

from fractions import Fraction
from importlib import import_module
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import PrerequisiteError

if TYPE_CHECKING:
    from pathlib import Path

Bytes = NDArray[np.uint8]

# The first that FFmpeg has: H.264 plays everywhere, and some builds leave it out for its patents.
_CODECS: tuple[tuple[str, dict[str, str]], ...] = (
    ("libx264", {"crf": "20", "preset": "veryfast"}),
    ("libvpx-vp9", {"crf": "30", "b": "0", "deadline": "realtime"}),
    ("mpeg4", {"qscale": "3"}),
)


def video_library() -> Any:
    """Return the package `av`.

    Raises:
        PrerequisiteError: it is missing, or does not start.
    """
    try:
        return import_module("av")
    except ImportError as error:
        raise PrerequisiteError(
            f"videos need the package av (PyAV): {error}", fix="pip install 'nw-eval[video]'"
        ) from error


class VideoFile:
    """An MP4 file that pictures are added to; a context manager.

    Args:
        path: of the file.
        size: width and height, even numbers of pixels.
        rate: pictures a second.

    Raises:
        PrerequisiteError: PyAV is not installed, or its FFmpeg has no encoder for such a file.
        OSError: (every method) the file cannot be written.
    """

    def __init__(self, path: Path, *, size: tuple[int, int], rate: int) -> None:
        self._av = video_library()
        codec, options = self._codec()
        self._file: Any = self._av.open(str(path), "w", format="mp4")
        self._stream: Any = self._file.add_stream(codec, rate=rate, options=options)
        self._stream.width, self._stream.height = size
        self._stream.pix_fmt = "yuv420p"
        self._stream.time_base = Fraction(1, rate)
        # One, so that the same pictures make the same bytes.
        self._stream.thread_count = 1
        self._count = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def add(self, picture: Bytes) -> None:
        """Add the next picture, (height, width, 3) sRGB."""
        frame = self._av.VideoFrame.from_ndarray(picture, format="rgb24")
        frame.pts = self._count
        self._count += 1
        for packet in self._stream.encode(frame):
            self._file.mux(packet)

    def close(self) -> None:
        """Write what waits, and the file's end; calling it again does nothing."""
        if self._file is not None:
            for packet in self._stream.encode():
                self._file.mux(packet)
            self._file.close()
            self._file = None

    def _codec(self) -> tuple[str, dict[str, str]]:
        known: Any = self._av.codecs_available
        for name, options in _CODECS:
            if name in known:
                return name, options
        raise PrerequisiteError(
            "the FFmpeg of the installed av writes neither H.264, nor VP9, nor MPEG-4",
            fix="pip install --force-reinstall --only-binary av av",
        )
