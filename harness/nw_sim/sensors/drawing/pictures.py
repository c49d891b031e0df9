"""Samples of sensors as pictures for people, a colour for each class of things, and sheets.

On a sheet, every word of a picture's label is written, in as many lines as it takes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from nw_base.clean import clean
from nw_scenes.mesh import FACE_KINDS, FaceKind

if TYPE_CHECKING:
    from PIL import Image as PillowImage


ClassName = Literal[
    "nothing", "ground", "obstacle", "structure", "clutter", "overhead", "cone", "robot"
]
CLASSES: tuple[ClassName, ...] = get_args(ClassName)

NOTHING, CONE, ROBOT = (CLASSES.index(name) for name in ("nothing", "cone", "robot"))

_OF_KIND: dict[FaceKind, ClassName] = {
    "ground": "ground",
    "obstacle": "obstacle",
    "structure": "structure",
    "clutter": "clutter",
    "overhead": "overhead",
    "beside": "structure",
}
FACE_CLASSES = np.array([CLASSES.index(_OF_KIND[kind]) for kind in FACE_KINDS], dtype=np.uint8)
"""For each kind of a mesh's faces, its class."""

PALETTE = np.array(
    [
        (178, 205, 228),  # nothing: the sky
        (128, 116, 104),  # ground
        (214, 120, 44),  # obstacle
        (92, 112, 140),  # structure
        (146, 120, 168),  # clutter
        (88, 148, 84),  # overhead
        (230, 62, 40),  # cone
        (40, 44, 52),  # robot
    ],
    dtype=np.uint8,
)
"""(classes, 3), sRGB."""


Bytes = NDArray[np.uint8]
Size = tuple[int, int]
"""Width and height, pixels."""

_PAPER = 250
_INK = np.array((38, 44, 54), dtype=np.uint8)


def coloured(values: NDArray[Any], low: float, high: float, colours: str = "turbo") -> Bytes:
    """Return numbers (H, W) as colours (H, W, 3); NaN is grey.

    Args:
        values: any numbers.
        low: the number of the first colour.
        high: the number of the last one.
        colours: a colour map of matplotlib.
    """
    from matplotlib import colormaps

    share = np.clip((values.astype(np.float64) - low) / max(high - low, 1e-12), 0.0, 1.0)
    table = (np.asarray(colormaps[colours](np.linspace(0.0, 1.0, 256)))[:, :3] * 255).round()
    image = table[np.nan_to_num(share * 255.0).round().astype(np.intp)]
    image[~np.isfinite(share)] = 128
    return image.astype(np.uint8)


def picture_of(sample: NDArray[Any], unit: str) -> Bytes | None:
    """Return any sample that can be looked at as an image (H, W, 3); None for rows of numbers.

    Args:
        sample: (H, W), (H, W, C), (C, H, W), or a stack of one of these, of which the newest shows.
        unit: of the sensor; `class` is shown in the colours of `PALETTE`, and `rgb`
            may have the colours of several images along its channels, the newest last.
    """
    if unit == "class" and sample.ndim == 2 and sample.max(initial=0) < len(CLASSES):
        return PALETTE[sample.astype(np.intp)]
    while sample.ndim > 3:
        sample = sample[-1]
    if unit == "rgb" and sample.ndim == 3:
        sample = _newest_colours(sample)
    if sample.ndim == 3 and sample.shape[-1] > 4:
        # Few channels before many rows and columns; else a stack of flat images.
        sample = np.moveaxis(sample, 0, -1) if sample.shape[0] in {1, 3} else sample[-1]
    if sample.ndim == 3 and sample.shape[-1] == 1:
        sample = sample[..., 0]
    if sample.ndim == 2 and min(sample.shape) > 1:
        finite = sample[np.isfinite(sample)].astype(np.float64)
        low, high = (finite.min(), finite.max()) if finite.size else (0.0, 1.0)
        return coloured(sample, low, high, "gray" if sample.dtype == np.uint8 else "turbo")
    if sample.ndim == 3 and sample.shape[-1] == 3:
        if sample.dtype == np.uint8:
            return sample
        if unit == "m":
            return None  # Points, not colours.
        low, high = float(sample.min()), float(sample.max())
        return ((sample - low) / max(high - low, 1e-12) * 255).astype(np.uint8)
    return None


def _newest_colours(sample: NDArray[Any]) -> NDArray[Any]:
    """Return the last three channels of images that are stacked along the channels."""
    first, _, last = sample.shape
    if first % 3 == 0 and first < last:
        return sample[-3:]
    return sample[..., -3:] if last % 3 == 0 and last < first else sample


def enlarged(image: Bytes, size: Size) -> Bytes:
    """Return an image at another size, pixels as squares, on paper where the shapes differ."""
    width, height = size
    scale = min(width / image.shape[1], height / image.shape[0])
    rows = max(1, round(image.shape[0] * scale))
    columns = max(1, round(image.shape[1] * scale))
    i = np.minimum(np.arange(rows) * image.shape[0] // rows, image.shape[0] - 1)
    j = np.minimum(np.arange(columns) * image.shape[1] // columns, image.shape[1] - 1)
    canvas = np.full((height, width, 3), _PAPER, dtype=np.uint8)
    top, left = (height - rows) // 2, (width - columns) // 2
    canvas[top : top + rows, left : left + columns] = image[i][:, j]
    return canvas


def points_from_behind(
    points: NDArray[np.floating], size: Size, *, reach: float = 5.0, dot: int = 2
) -> Bytes:
    """Return points of a scanner as seen from behind and above it, coloured by height.

    Args:
        points: (N, 3) m in the sensor's frame (x ahead, y left, z up); NaN is left out.
        size: of the picture.
        reach: about how far ahead the picture shows, m.
        dot: edge of a point, pixels.
    """
    width, height = size
    canvas = np.full((height, width, 3), 18, dtype=np.uint8)
    points = points[np.isfinite(points).all(axis=1)]
    eye, pitch = np.array([-0.55, 0.0, 0.42]) * reach, 0.42
    c, s = np.cos(pitch), np.sin(pitch)
    offset = points - eye
    depth = c * offset[:, 0] - s * offset[:, 2]
    up = s * offset[:, 0] + c * offset[:, 2]
    ahead = depth > 0.05 * reach
    depth, up, left = depth[ahead], up[ahead], offset[ahead, 1]
    focal = 0.85 * width / 2
    column = (width / 2 - focal * left / depth).astype(np.intp)
    row = (height / 2 - focal * up / depth).astype(np.intp)
    colours = coloured(points[ahead, 2][np.newaxis], -0.5, 1.5)[0]
    order = np.argsort(-depth)  # Far points first; near ones cover them.
    for down in range(dot):
        for right in range(dot):
            i, j = row[order] + down, column[order] + right
            inside = (i >= 0) & (i < height) & (j >= 0) & (j < width)
            canvas[i[inside], j[inside]] = colours[order][inside]
    return canvas


def dots_from_above(values: NDArray[np.floating], size: Size) -> Bytes:
    """Return a grid of numbers (x, y) as round dots seen from above, ahead upwards."""
    width, height = size
    canvas = np.full((height, width, 3), _PAPER, dtype=np.uint8)
    colours = coloured(values, float(values.min()), float(values.max()) + 1e-3, "viridis")
    step = min(height / values.shape[0], width / values.shape[1])
    rows, columns = np.mgrid[:height, :width]
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            # x grows ahead, which is up; y grows to the left.
            row = height / 2 + (values.shape[0] / 2 - i - 0.5) * step
            column = width / 2 + (values.shape[1] / 2 - j - 0.5) * step
            disc = (rows - row) ** 2 + (columns - column) ** 2 < (0.38 * step) ** 2
            canvas[disc] = colours[i, j]
    return canvas


def map_from_above(values: NDArray[np.floating], size: Size) -> Bytes:
    """Return a map (x, y) of heights as seen from above, ahead upwards."""
    image = coloured(values[::-1, ::-1], float(values.min()), float(values.max()) + 1e-3, "viridis")
    return enlarged(image, size)


def bars(values: NDArray[np.floating], size: Size, *, limit: float = 1.0) -> Bytes:
    """Return numbers as bars around a middle line; a bar ends at `limit`."""
    width, height = size
    canvas = np.full((height, width, 3), _PAPER, dtype=np.uint8)
    middle, half = height // 2, 0.45 * height
    canvas[middle] = 190
    pitch = width / len(values)
    for number, value in enumerate(np.clip(values / limit, -1.0, 1.0)):
        left, right = int(number * pitch) + 1, int((number + 1) * pitch)
        end = round(middle - float(value) * half)
        canvas[min(end, middle) : max(end, middle) + 1, left:right] = _INK
    return canvas


def arrow(angle: float, size: Size) -> Bytes:
    """Return an arrow that points `angle` rad to the left of straight ahead (up)."""
    width, height = size
    canvas = np.full((height, width, 3), _PAPER, dtype=np.uint8)
    y, x = np.mgrid[:height, :width].astype(np.float64)
    x, y = x - width / 2, height / 2 - y
    radius = 0.42 * min(size)
    canvas[np.abs(np.hypot(x, y) - radius) < 1.2] = 170
    ahead = (np.abs(x) < 1.0) & (y > radius - 8) & (y < radius + 8)
    canvas[ahead] = 120
    along = -np.sin(angle) * x + np.cos(angle) * y
    across = np.cos(angle) * x + np.sin(angle) * y
    shaft = (np.abs(across) < 3) & (along > -0.5 * radius) & (along < 0.6 * radius)
    head = (along >= 0.6 * radius) & (np.abs(across) < 0.55 * (radius - along))
    canvas[shaft | head] = PALETTE[CLASSES.index("cone")]
    return canvas


_GAP = 8  # pixels
_TEXT, _FAINT = (20, 24, 30), (96, 102, 112)
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
            text_strip(cell.name, width, size=_NAME, colour=_TEXT),
            *([text_strip(cell.caption, width, size=_CAPTION, colour=_FAINT)] * bool(cell.caption)),
        ]
        for cell in cells
    ]
    placed: list[tuple[PillowImage.Image, int, int]] = []
    y = _GAP
    if title:
        strip = text_strip(title, full, size=_TITLE, colour=_TEXT)
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
    text: str, width: int, *, size: int, colour: tuple[int, int, int] = _TEXT
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
