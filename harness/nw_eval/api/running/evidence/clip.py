"""The last seconds of a camera's pictures as one that moves: an animated WebP, small enough."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from itertools import pairwise
from typing import TYPE_CHECKING

from nw_eval.api.running.evidence.content import ReadClip

if TYPE_CHECKING:
    from PIL.Image import Image

SECONDS = 3.0
"""Of simulated time that a clip shows; a fall takes one."""

PERIOD = 0.1
"""Seconds between two of its pictures, at the least."""

_HOLD = 1200  # ms that the last picture stands
_LARGE, _SMALL = 256, 160  # pixels of the longer side: pictures shrink to it, or grow towards it
# Quality, and of how many pictures one is kept: the first attempt that fits.
_ATTEMPTS = ((60, 1), (35, 1), (35, 2), (15, 2), (15, 4))


def clip_of(
    pictures: Sequence[tuple[float, Image]], *, topic: str, most_bytes: int
) -> ReadClip | None:
    """Return a clip, or None if it fits in no quality.

    Args:
        pictures: (seconds, image as `sized` gives it) in the order of time, at least one.
        topic: where they are in the log.
        most_bytes: of the clip and its last picture together.
    """
    last = pictures[-1][1]
    frames = [(time, picture.resize(last.size)) for time, picture in pictures]
    for quality, step in _ATTEMPTS:
        kept = frames[::-1][::step][::-1]  # The last one stays.
        data, still = _webp(kept, quality), _webp(kept[-1:], quality)
        if len(data) + len(still) <= most_bytes:
            return ReadClip(
                data=data,
                still=still,
                width=last.width,
                height=last.height,
                topic=topic,
                seconds=round(kept[-1][0] - kept[0][0], 3),
            )
    return None


def sized(picture: Image) -> Image:
    """Return a picture in colours, about as large as a page shows it."""
    from PIL.Image import Resampling

    side = max(picture.size)
    grow = max(1, _SMALL // side)
    scale = grow * min(1.0, _LARGE / side)
    width, height = (max(1, round(pixels * scale)) for pixels in picture.size)
    how = Resampling.NEAREST if grow > 1 else Resampling.BOX
    return picture.convert("RGB").resize((width, height), how)


def _webp(frames: Sequence[tuple[float, Image]], quality: int) -> bytes:
    stands = [round(1000 * (later - time)) for (time, _), (later, _) in pairwise(frames)]
    file = BytesIO()
    frames[0][1].save(
        file,
        "WEBP",
        quality=quality,
        save_all=True,
        append_images=[image for _, image in frames[1:]],
        duration=[*stands, _HOLD],
        loop=0,
    )
    return file.getvalue()
