"""Sheets of labelled pictures: every word of a label is on them, in as many lines as it takes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.clean import clean

if TYPE_CHECKING:
    from PIL import Image as PillowImage

Bytes = NDArray[np.uint8]

_GAP = 8  # pixels
_INK, _FAINT = (20, 24, 30), (96, 102, 112)
_TITLE, _NAME, _CAPTION = 17, 14, 12  # pixels, of letters


@dataclass(frozen=True, kw_only=True)
class Cell:
    """Pictures below one another, under a name and a line about them."""

    name: str
    caption: str = ""
    images: Sequence[Bytes]


def draw_sheet(cells: Sequence[Cell], *, across: int, title: str = "") -> bytes:
    """Return cells in rows, under a title, as a PNG.

    Args:
        cells: their pictures all have one width.
        across: cells in a row.
        title: of the whole sheet.
    """
    from PIL import Image as PillowImage

    across = min(across, len(cells))
    width = cells[0].images[0].shape[1]
    full = across * (width + _GAP) - _GAP
    heads = [
        [
            text_strip(cell.name, width, size=_NAME, colour=_INK),
            *([text_strip(cell.caption, width, size=_CAPTION, colour=_FAINT)] * bool(cell.caption)),
        ]
        for cell in cells
    ]
    placed: list[tuple[PillowImage.Image, int, int]] = []
    y = _GAP
    if title:
        strip = text_strip(title, full, size=_TITLE, colour=_INK)
        placed.append((strip, _GAP, y))
        y += strip.height + _GAP
    for start in range(0, len(cells), across):
        row = range(start, min(start + across, len(cells)))
        # The pictures of a row begin at one height, however long its labels are.
        label = max(sum(strip.height for strip in heads[number]) for number in row)
        below = y
        for number in row:
            x, at = _GAP + (number - start) * (width + _GAP), y
            for strip in heads[number]:
                placed.append((strip, x, at))
                at += strip.height
            at = y + label
            for image in cells[number].images:
                placed.append((PillowImage.fromarray(image), x, at))
                at += image.shape[0]
            below = max(below, at)
        y = below + _GAP
    sheet = PillowImage.new("RGB", (full + 2 * _GAP, y), "white")
    for part, x, at in placed:
        sheet.paste(part, (x, at))
    with BytesIO() as file:
        sheet.save(file, format="PNG", optimize=True)
        return file.getvalue()


def text_strip(
    text: str, width: int, *, size: int, colour: tuple[int, int, int] = _INK
) -> PillowImage.Image:
    """Return a strip with a text in lines that fit a width; sizes in pixels."""
    from PIL import Image as PillowImage
    from PIL import ImageDraw, ImageFont

    font = ImageFont.load_default(size=size)
    lines = wrapped(clean(text), width - 2, font)  # Letters lean out of their boxes a little.
    height = round(1.4 * size)
    strip = PillowImage.new("RGB", (width, height * len(lines)), "white")
    pen = ImageDraw.Draw(strip)
    for number, line in enumerate(lines):
        pen.text((0, number * height), line, fill=colour, font=font)
    return strip


def wrapped(text: str, width: int, font: Any) -> list[str]:
    """Return a text in lines of at most `width` pixels, broken at blanks, and in words if need be.

    Args:
        text: one line.
        width: pixels.
        font: of Pillow.
    """
    lines = [""]
    for word in text.split():
        joined = f"{lines[-1]} {word}".strip()
        if font.getlength(joined) <= width:
            lines[-1] = joined
            continue
        if lines[-1]:
            lines.append("")
        for letter in word:
            if lines[-1] and font.getlength(lines[-1] + letter) > width:
                lines.append("")
            lines[-1] += letter
    return lines
