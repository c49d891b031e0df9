"""Frames of a video: as far apart as the picture moved, or in time, and there the sharpest."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from nw_base.errors import SceneError
from nw_twin.calibrate.photographs import HDR, Footage, Found, sharpness_of, tone_mapped
from nw_twin.calibrate.report import Pace, Say
from nw_twin.packages import package

VIDEOS = frozenset(
    (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".mts", ".mpg", ".mpeg", ".3gp")
)
_CONTAINERS = "mov,matroska,avi,mpegts,mpeg,mpegvideo"
"""The readers of FFmpeg for these; others (playlists, sessions) open further files and servers."""
_STEP = 0.06
"""Of the picture's width that it moves from one chosen frame to the next."""
_RATE = 15.0
"""Frames a second that are looked at."""
_USUAL_RATE = 30.0
"""Frames a second of a film whose header and stamps say nothing that can be."""
_FLOW_WIDTH, _LEAST_SIDE = 160, 8


def frames_of(
    path: Path, working: Path, most: int, say: Say, *, per_second: float | None = None
) -> Footage:
    """Return the chosen frames of a video, written into the working folder.

    Args:
        path: of the video.
        working: gets `frames/`.
        most: frames that are chosen.
        say: is given lines of progress.
        per_second: frames of each second; None = as many as the picture moves.

    Raises:
        SceneError: it cannot be read, or holds fewer than 3 frames.
        PrerequisiteError: PyAV or OpenCV is not installed.
    """
    seen = _look(path, say, with_motion=per_second is None)
    if len(seen.numbers) < 3 <= seen.read:
        say(f"{seen.read} frames claim to last {seen.lasted:.2g} s: they are taken for 30 a second")
        seen = _look(path, say, with_motion=per_second is None, rate=_USUAL_RATE)
    if len(seen.numbers) < 3:
        raise SceneError(f"{path} holds {len(seen.numbers)} frames", fix="film for some seconds")
    sharpness = np.array(seen.sharpness)
    if per_second is None:
        chosen = choose(np.array(seen.moved), sharpness, most)
    else:
        chosen = choose_by_time(np.array(seen.times), sharpness, per_second, most, say)
    numbers = [seen.numbers[i] for i in chosen]
    say(f"{len(chosen)} frames of {path.name} chosen")
    if seen.transfer in HDR:
        say(f"{path.name} is HDR ({HDR[seen.transfer]}): its frames are tone-mapped to sRGB")
    folder = working / "frames"
    folder.mkdir()
    files: list[Found] = []
    wanted = set(numbers)
    for number, frame in _frames(path):
        if number in wanted:
            name = f"frame_{number:06d}.jpg"
            Image.fromarray(_rgb(frame)).save(folder / name, quality=97, subsampling=0)
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
    return _sharpest(way / max(float(way[-1]), 1e-12) * stretches, sharpness, stretches)


def choose_by_time(
    times: NDArray[np.float64],
    sharpness: NDArray[np.float64],
    per_second: float,
    most: int,
    say: Say,
) -> list[int]:
    """Return the sharpest frame of each stretch of time.

    Args:
        times: (N,) seconds, rising.
        sharpness: (N,) of each.
        per_second: stretches in a second.
        most: that are taken; where there are more stretches, they are made longer.
        say: receives a message about that.
    """
    stretches = max(1, math.ceil((times[-1] - times[0]) * per_second + 1e-6))
    if stretches > most:
        say(
            f"{per_second:g} frames a second are {stretches}: {most} are taken, "
            f"one every {(times[-1] - times[0]) / most:.2g} s (--frames {stretches} takes all)"
        )
        per_second *= most / stretches
        stretches = most
    return _sharpest((times - times[0]) * per_second, sharpness, stretches)


def _sharpest(
    along: NDArray[np.float64], sharpness: NDArray[np.float64], stretches: int
) -> list[int]:
    stretch = np.minimum(along.astype(int), stretches - 1)
    return [
        int(rows[np.argmax(sharpness[rows])])
        for rows in (np.flatnonzero(stretch == s) for s in range(stretches))
        if len(rows)
    ]


@dataclass
class _Seen:
    """Frames that were looked at: their numbers, seconds, sharpness, and share of motion.

    And how many were read, and the seconds that they claim to last.
    """

    transfer: int = 0
    read: int = 0
    lasted: float = 0.0
    numbers: list[int] = field(default_factory=list[int])
    times: list[float] = field(default_factory=list[float])
    sharpness: list[float] = field(default_factory=list[float])
    moved: list[float] = field(default_factory=list[float])


def _look(path: Path, say: Say, *, with_motion: bool, rate: float | None = None) -> _Seen:
    cv2 = package("cv2")
    seen = _Seen()
    before, due = None, -math.inf
    with _opened(path) as (_, stream):
        header, total = float(stream.average_rate or _RATE), int(stream.frames or 0)
    pace = Pace(say, "frames looked at", total)
    for number, frame in _frames(path):
        time = number / header if frame.time is None else frame.time  # Phones vary their rate.
        if rate is not None:
            time = number / rate
        seen.read, seen.lasted = number + 1, time
        if time < due:
            continue
        due = time + 0.99 / _RATE
        if min(frame.width, frame.height) < max(_LEAST_SIDE, frame.width / 50, frame.height / 50):
            raise SceneError(
                f"{path} has pictures of {frame.width} x {frame.height} pixels, which show nothing",
                fix="film again",
            )
        grey = _upright(frame, frame.to_ndarray(format="gray"))
        moved = 0.0
        if with_motion:
            scale = _FLOW_WIDTH / max(grey.shape)
            small = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
            if before is not None and before.shape == small.shape:
                flow = cv2.calcOpticalFlowFarneback(before, small, None, 0.5, 3, 15, 2, 5, 1.1, 0)
                moved = float(np.linalg.norm(flow, axis=2).mean()) / _FLOW_WIDTH
            before = small
        seen.transfer = int(frame.color_trc)
        seen.numbers.append(number)
        seen.times.append(time)
        seen.sharpness.append(sharpness_of(grey)[0])
        seen.moved.append(moved)
        if total:
            pace.at(min(number + 1, total - 1))
    return seen


@contextmanager
def _opened(path: Path) -> Generator[tuple[Any, Any]]:
    av = package("av")
    try:
        allowed = {"format_whitelist": _CONTAINERS, "protocol_whitelist": "file"}
        with av.open(str(path), options=allowed) as container:
            stream = container.streams.best("video")  # None of the others is a cover.
            if stream is None:
                raise SceneError(f"{path} holds no pictures", fix="give a video")
            yield container, stream
    except (av.error.FFmpegError, OSError, ValueError) as error:
        raise SceneError(
            f"the video {path} cannot be read: {getattr(error, 'strerror', None) or error}",
            fix="save it again, as MP4",
        ) from None


def _frames(path: Path) -> Iterator[tuple[int, Any]]:
    with _opened(path) as (container, stream):
        yield from enumerate(container.decode(stream))


def _rgb(frame: Any) -> NDArray[np.uint8]:
    """Return a frame as it is to be seen, (H, W, 3)."""
    transfer = int(frame.color_trc)
    if transfer not in HDR:
        return _upright(frame, frame.to_ndarray(format="rgb24"))
    return _upright(frame, tone_mapped(frame.to_ndarray(format="rgb48le"), transfer))


def _upright(frame: Any, pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a frame's pixels turned and mirrored as its display matrix says.

    Phones film sideways and say so. The matrix maps a pixel (x, y) to (a x + c y, b x + d y).
    """
    matrices = (one for one in frame.side_data if one.type.name == "DISPLAYMATRIX")
    matrix = next(matrices, None)
    if matrix is None:
        return pixels
    (a, b, _), (c, d, _) = np.frombuffer(bytes(matrix), np.int32).reshape(3, 3)[:2].tolist()
    across = abs(b) > abs(a)
    pixels = pixels.swapaxes(0, 1) if across else pixels
    right, down = (c, b) if across else (a, d)
    return np.ascontiguousarray(pixels[:: -1 if down < 0 else 1, :: -1 if right < 0 else 1])
