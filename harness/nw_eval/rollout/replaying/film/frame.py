"""One picture of a video: the view from outside beside the policy's own, over two lines of words.

Who drives is said in words, and by the colour of a band; it changes when another policy takes over.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nw_eval.clean import clean
from nw_eval.sensors.drawing.pictures import enlarged

if TYPE_CHECKING:
    from PIL import ImageDraw

Bytes = NDArray[np.uint8]

VIEW = (400, 225)
"""Width and height of each of the two views, pixels."""
FRAME = (2 * VIEW[0], VIEW[1] + 67)
"""Of the whole picture; even, as video wants it."""

_BAND = 6  # pixels
_GROUND, _INK, _FAINT = (18, 22, 28), (240, 242, 245), (160, 168, 178)
_DRIVERS = ((74, 144, 226), (245, 140, 40))
"""The band's colours: of whoever began, of whoever took over."""
_LARGE, _SMALL, _LABEL = 18, 14, 12  # pixels, of letters


@dataclass(frozen=True, kw_only=True)
class Words:
    """What stands under the views, and in them."""

    time: float
    """s"""
    waypoints: str
    """Such as `2 of 4 waypoints`."""
    driver: str
    """Who drives."""
    has_taken_over: bool
    own: str
    """What the policy's own view is."""
    news: str = ""
    """What has just happened, or how it ended; drawn across the picture's middle."""


def composed(beside: Bytes, own: Bytes, words: Words) -> Bytes:
    """Return one picture, (`FRAME` height, width, 3).

    Args:
        beside: the view from outside, (H, W, 3).
        own: the policy's own view, likewise; both are fitted into `VIEW`.
        words: see there.
    """
    from PIL import Image, ImageDraw

    width, height = VIEW
    colour = _DRIVERS[words.has_taken_over]
    picture = Image.new("RGB", FRAME, _GROUND)
    picture.paste(Image.fromarray(enlarged(beside, VIEW)), (0, 0))
    picture.paste(Image.fromarray(enlarged(own, VIEW)), (width, 0))
    pen = ImageDraw.Draw(picture)
    _label(pen, (8, 6), "from outside")
    _label(pen, (width + 8, 6), words.own)
    pen.rectangle((0, height, FRAME[0], height + _BAND), fill=colour)
    y = height + _BAND + 8
    _write(pen, (12, y), f"{words.time:5.2f} s", _LARGE, _INK)
    _write(pen, (110, y), words.waypoints, _LARGE, _INK)
    _write(pen, (12, y + 27), f"driven by {words.driver}", _SMALL, colour)
    if words.news:
        _announce(pen, words.news, colour)
    return np.asarray(picture)


def _announce(pen: ImageDraw.ImageDraw, text: str, colour: tuple[int, int, int]) -> None:
    """Draw a frame round the views, and a line of words across their foot."""
    width, height = FRAME[0], VIEW[1]
    pen.rectangle((0, 0, width - 1, height - 1), outline=colour, width=_BAND)
    pen.rectangle((0, height - 34, width, height), fill=colour)
    _write(pen, (14, height - 29), text, _LARGE, _GROUND)


def _label(pen: ImageDraw.ImageDraw, at: tuple[int, int], text: str) -> None:
    from PIL import ImageFont

    box = pen.textbbox(at, text, font=ImageFont.load_default(size=_LABEL))
    pen.rectangle((box[0] - 4, box[1] - 3, box[2] + 4, box[3] + 3), fill=_GROUND)
    _write(pen, at, text, _LABEL, _FAINT)


def _write(
    pen: ImageDraw.ImageDraw,
    at: tuple[int, int],
    text: str,
    size: int,
    colour: tuple[int, int, int],
) -> None:
    from PIL import ImageFont

    words = clean(text, at_most=140)  # Names of policies may be a stranger's.
    pen.text(at, words, fill=colour, font=ImageFont.load_default(size=size))
