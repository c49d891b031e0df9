"""Frames of a video: as far apart as the picture moved, and of those about there the sharpest."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from nw_eval.errors import SceneError
from nw_eval.twin.calibrate.footage import Footage
from nw_eval.twin.calibrate.pace import Pace, Say
from nw_eval.twin.calibrate.packages import package
from nw_eval.twin.calibrate.photographs import Found, sharpness_of

VIDEOS = frozenset(
    (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".mts", ".mpg", ".mpeg", ".3gp")
)
_STEP = 0.06
"""Of the picture's width that it moves from one chosen frame to the next."""
_RATE = 15.0
"""Frames a second that are looked at."""
_FLOW_WIDTH = 160


def frames_of(path: Path, working: Path, most: int, say: Say) -> Footage:
    """Return the chosen frames of a video, written into the working folder.

    Args:
        path: of the video.
        working: gets `frames/`.
        most: frames that are chosen.
        say: is given lines of progress.

    Raises:
        SceneError: it cannot be read, or holds fewer than 3 frames.
        PrerequisiteError: PyAV or OpenCV is not installed.
    """
    moved, sharpness, numbers = _look(path, say)
    if len(numbers) < 3:
        raise SceneError(f"{path} holds {len(numbers)} frames", fix="film for some seconds")
    chosen = [numbers[i] for i in choose(moved, sharpness, most)]
    say(f"{len(chosen)} frames of {path.name} chosen")
    folder = working / "frames"
    folder.mkdir()
    files: list[Found] = []
    wanted = set(chosen)
    for number, frame in _frames(path):
        if number in wanted:
            name = f"frame_{number:06d}.jpg"
            Image.fromarray(_upright(frame, "rgb24")).save(folder / name, quality=97, subsampling=0)
            files.append(Found(name=name, path=folder / name))
        if len(files) == len(chosen):
            break
    return Footage(kind="video", files=tuple(files), is_film=True)


def choose(moved: NDArray[np.float64], sharpness: NDArray[np.float64], most: int) -> list[int]:
    """Return which frames to take.

    The film is cut into stretches over which the picture moves as far as in every other, at least
    6 % of its width; the sharpest frame of each is taken. While the camera rests, none is.

    Args:
        moved: (N,) shares of the width that the picture moved since the frame before.
        sharpness: (N,) of each.
        most: that are taken.
    """
    way = np.cumsum(moved)
    stretches = int(np.clip(math.ceil(way[-1] / _STEP), min(3, len(moved)), most))
    length = max(float(way[-1]), 1e-12)
    stretch = np.minimum((way / length * stretches).astype(int), stretches - 1)
    return [
        int(rows[np.argmax(sharpness[rows])])
        for rows in (np.flatnonzero(stretch == s) for s in range(stretches))
        if len(rows)
    ]


def _look(path: Path, say: Say) -> tuple[NDArray[np.float64], NDArray[np.float64], list[int]]:
    cv2 = package("cv2")
    moved: list[float] = []
    sharpness: list[float] = []
    numbers: list[int] = []
    before = None
    with _opened(path) as (_, stream):
        every = max(1, round(float(stream.average_rate or _RATE) / _RATE))
        total = int(stream.frames or 0)
    pace = Pace(say, "frames looked at", total)
    for number, frame in _frames(path):
        if number % every:
            continue
        grey = _upright(frame, "gray")
        scale = _FLOW_WIDTH / max(grey.shape)
        small = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        if before is not None and before.shape == small.shape:
            flow = cv2.calcOpticalFlowFarneback(before, small, None, 0.5, 3, 15, 2, 5, 1.1, 0)
            moved.append(float(np.linalg.norm(flow, axis=2).mean()) / _FLOW_WIDTH)
        else:
            moved.append(0.0)
        before = small
        sharpness.append(sharpness_of(grey)[0])
        numbers.append(number)
        if total:
            pace.at(min(number + 1, total - 1))
    return np.array(moved), np.array(sharpness), numbers


@contextmanager
def _opened(path: Path) -> Generator[tuple[Any, Any]]:
    av = package("av")
    try:
        with av.open(str(path)) as container:
            if not container.streams.video:
                raise SceneError(f"{path} holds no pictures", fix="give a video")
            yield container, container.streams.video[0]
    except (av.error.FFmpegError, OSError, ValueError) as error:
        raise SceneError(
            f"the video {path} cannot be read: {error}", fix="save it again, as MP4"
        ) from None


def _frames(path: Path) -> Iterator[tuple[int, Any]]:
    with _opened(path) as (container, stream):
        yield from enumerate(container.decode(stream))


def _upright(frame: Any, pixels: str) -> NDArray[np.uint8]:
    """Return a frame as it is to be seen; phones film sideways and say so."""
    array = frame.to_ndarray(format=pixels)
    return np.ascontiguousarray(np.rot90(array, round(frame.rotation / 90) % 4))
