"""Reads elevation maps: pictures whose grey says how high the ground is, and GeoTIFF.

Tags of GeoTIFF after OGC 19-008r4, https://docs.ogc.org/is/19-008r4/19-008r4.html; a height that
means none, scale, offset and unit of a band, and masks after
https://gdal.org/drivers/raster/gtiff.html (tags 42112 and 42113). Every tag of a TIFF is used,
passed over because no height depends on it, or named in a remark.
"""

from __future__ import annotations

import math
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import fromstring

import numpy as np
from numpy.typing import NDArray

from nw_base.clean import clean
from nw_base.errors import SceneError, UsageError
from nw_base.files.pictures import open_picture
from nw_scenes.limits import CELLS

if TYPE_CHECKING:
    from PIL.Image import Image

ELEVATION_SUFFIXES = (".png", ".tif", ".tiff")

_PIXEL_SCALE, _TRANSFORMATION, _GEO_KEYS, _METADATA, _NO_DATA = 33550, 34264, 34735, 42112, 42113
_PAGE = 254
_OVERVIEW, _MASK = 1, 4
_USED = {_PIXEL_SCALE, _TRANSFORMATION, _GEO_KEYS, _METADATA, _NO_DATA, _PAGE}
_PASSED = {
    *(256, 257, 258, 259, 262, 266, 273, 274, 277, 278, 279, 284, 317, 320, 322, 323, 324, 325),
    *(338, 339, 347, 50674),  # How pixels are stored: Pillow reads them.
    *(282, 283, 296),  # Dots to an inch of paper.
    *(255, 269, 270, 271, 272, 285, 297, 305, 306, 315, 316, 700, 33432, 34377, 34665, 34675),
    *(340, 341, 33922, 34736, 34737),  # Least and most; where on Earth, which no scene has.
}
"""Tags that no height depends on."""
_MODEL, _PROJECTED, _LINEAR, _DATUM, _VERTICAL = 1024, 3072, 3076, 4096, 4099
_PASSED_KEYS = {1025, 1026, *range(2048, 2063), *range(3073, 3097), 4097, 4098} - {_LINEAR}
"""Whether a value is of a pixel's middle, and where on Earth: names, datums, projections."""
_GEOGRAPHIC = 2
_MERCATORS = {3395, 3857, 102100, 900913}
# Metres in a unit, by its EPSG code: metre, international foot, US survey foot.
_UNITS = {9001: 1.0, 9002: 0.3048, 9003: 1200.0 / 3937.0}
_DATUMS = {8228: 9002, 6360: 9003}  # NAVD88 in feet; all others that are in use are in metres.
_NAMED_UNITS = {
    **dict.fromkeys(("m", "metre", "metres", "meter", "meters"), 9001),
    **dict.fromkeys(("ft", "foot", "feet", "international foot"), 9002),
    **dict.fromkeys(("us-ft", "ftus", "us survey foot", "us survey feet", "foot_us"), 9003),
}
_LONGEST, _PAGES = 1 << 16, 32
_PROJECT = "project it first, such as with `gdalwarp -t_srs EPSG:32632` of your UTM zone"
_ENOUGH_WHITE = (255.0, 65535.0)
_WIDEST_CELL = 1e3
_PASSES = (
    *((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2)),
    (0, 1, 1, 2),
)
"""Of an interlaced PNG: first column and row, and from one to the next (PNG, section 8.2)."""
_HIGHEST = 1e5
"""Metres above or below zero that ground on Earth does not reach."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ElevationMap:
    """Heights of the ground on a regular grid.

    Attributes:
        heights: (R, C) float64, metres; nan where there is no ground. Row 0 is farthest along y,
            as a map has north above.
        cell: distance between columns and between rows, metres.
        findings: remarks for people, one line each.
    """

    heights: NDArray[np.float64]
    cell: tuple[float, float]
    findings: tuple[str, ...] = ()


def read_elevation(
    path: Path,
    *,
    cell: float | None = None,
    white: float | None = None,
    black: float = 0.0,
    no_data: float | None = None,
) -> ElevationMap:
    """Return the heights of an elevation map.

    Args:
        path: a PNG in grey (8 or 16 bits; transparent pixels are holes), or a TIFF whose numbers
            are heights.
        cell: width of a pixel, metres; None = what a GeoTIFF says.
        white: height of white, metres; of pictures only. None = a TIFF, whose numbers are metres.
        black: height of black, metres; of pictures only.
        no_data: the value of a pixel that has no ground; of a TIFF None = what its tag says.

    Raises:
        UsageError: a number is missing, or none.
        SceneError: the file cannot be read, is no elevation map, or is too large.
    """
    for name, value in (("--cell", cell), ("--white", white), ("--black", black)):
        if value is not None and not math.isfinite(value):
            raise UsageError(f"{name} {value}", fix="give metres")
    if cell is not None and cell <= 0.0:
        raise UsageError(
            f"--cell {cell} is not a width", fix="give the width of a pixel, metres, above 0"
        )
    if cell is not None and cell > _WIDEST_CELL:
        raise UsageError(
            f"--cell {cell:g} is too wide", fix=f"give metres, at most {_WIDEST_CELL:g}"
        )
    try:
        with open_picture(path, ("PNG", "TIFF")) as picture:
            _check_size(path, *picture.size)
            if picture.format == "TIFF":
                return _tiff(path, picture, cell, no_data, is_grey=white is not None or black != 0)
            return _png(path, picture, cell, white, black, no_data)
    except (UsageError, SceneError):
        raise
    except OSError as error:
        raise SceneError(
            f"{path}: no elevation map that can be read: {clean(error.strerror or str(error))}",
            fix="give a PNG in grey, or a GeoTIFF",
        ) from None
    except Exception as error:  # noqa: BLE001 - Pillow raises of many kinds at damaged files.
        raise SceneError(
            f"{path}: the picture is damaged: {clean(str(error), at_most=200)}",
            fix="export it again",
        ) from None


def _check_whole(path: Path) -> None:
    """Check that a PNG has all of its rows: Pillow shows those that it has not as black."""
    content = path.read_bytes()
    columns, rows, depth, colour, _, _, interlaced = struct.unpack(">IIBBBBB", content[16:29])
    bits = depth * {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}[colour]
    wanted = 0
    for x, y, dx, dy in _PASSES if interlaced else ((0, 0, 1, 1),):
        across, down = -(-(columns - x) // dx), -(-(rows - y) // dy)
        wanted += down * (1 + -(-across * bits // 8)) if across > 0 and down > 0 else 0
    inflater, size, at = zlib.decompressobj(), 0, 8
    while at + 12 <= len(content) and size < wanted:
        length, kind = struct.unpack(">I4s", content[at : at + 8])
        if kind == b"IDAT":
            size += len(inflater.decompress(content[at + 8 : at + 8 + length], wanted - size))
        at += 12 + length
    if size < wanted:
        raise SceneError(
            f"{path}: the picture is cut short: {size / wanted:.0%} of its rows are there",
            fix="export it again",
        )


def _check_size(path: Path, columns: int, rows: int) -> None:
    if columns * rows > CELLS:
        raise SceneError(
            f"{path}: {columns} x {rows} pixels, {columns * rows / 1e6:.1f} million",
            fix=f"crop or thin it out to {CELLS / 1e6:g} million at most",
        )
    if min(columns, rows) < 2:
        raise SceneError(f"{path}: {columns} x {rows} pixels", fix="give a map of an area")


def _png(
    path: Path,
    picture: Image,
    cell: float | None,
    white: float | None,
    black: float,
    no_data: float | None,
) -> ElevationMap:
    if cell is None or white is None:
        missing = [name for name, v in (("--cell", cell), ("--white", white)) if v is None]
        raise UsageError(
            f"{path}: a picture does not say how large it is, and {' and '.join(missing)} "
            f"{'is' if len(missing) == 1 else 'are'} missing",
            fix="give the width of a pixel and the height of white, metres: "
            "--cell 0.04 --white 1.25",
        )
    _check_whole(path)
    holes = None
    if picture.mode in {"P", "LA", "PA", "RGBA", "1"}:
        picture = picture.convert("L" if picture.mode == "1" else "RGBA")
    pixels = np.asarray(picture)
    if pixels.ndim == 3:
        if pixels.shape[2] == 4:
            holes = pixels[..., 3] == 0
        if (pixels[..., :3].max(axis=2) != pixels[..., :3].min(axis=2)).any():
            raise SceneError(
                f"{path}: a picture in colours, which say no height",
                fix="give heights in grey, or the mesh that the colours belong to",
            )
        pixels = pixels[..., 0]
    most = _ENOUGH_WHITE[0] if pixels.dtype == np.uint8 else _ENOUGH_WHITE[1]
    grey = pixels.astype(np.float64)
    heights = black + (white - black) * grey / most
    missing_ground = np.zeros(grey.shape, np.bool_) if holes is None else holes
    if no_data is not None:
        missing_ground = missing_ground | (grey == no_data)
    return _map(path, np.where(missing_ground, np.nan, heights), (cell, cell), ())


def _tiff(
    path: Path, picture: Image, cell: float | None, no_data: float | None, *, is_grey: bool
) -> ElevationMap:
    if is_grey:
        raise UsageError(
            f"{path}: the numbers of a TIFF are heights",
            fix="drop --white and --black, or give a PNG",
        )
    tags: Any = getattr(picture, "tag_v2", {})
    remarks: list[str] = []
    if len(picture.getbands()) != 1 or picture.mode in {"1", "P"}:
        raise SceneError(
            f"{path}: a TIFF of {len(picture.getbands())} bands ({picture.mode}) holds a picture, "
            "no heights",
            fix="give one band of numbers",
        )
    values = np.asarray(picture).astype(np.float64)
    keys = _geo_keys(tags)
    known = {_MODEL, _PROJECTED, _LINEAR, _DATUM, _VERTICAL} | _PASSED_KEYS
    odd = [f"tag {tag}" for tag in tags if tag not in _USED | _PASSED]
    if odd := [*odd, *(f"geo key {key}" for key in keys if key not in known)]:
        remarks.append(f"not read: {', '.join(odd[:8])}")
    sizes = _cells(path, tags, keys, cell, remarks)
    if no_data is None and _NO_DATA in tags:
        text = str(tags[_NO_DATA]).strip("\0 ")
        try:
            no_data = float(text)
        except ValueError:
            remarks.append(f"the value {clean(text, at_most=20)!r} for no ground is not a number")
    missing = ~np.isfinite(values)
    if no_data is not None and math.isfinite(no_data):
        # Written as decimal text, it need not be the float of the pixels to the last bit.
        missing |= np.isclose(values, no_data, rtol=1e-6, atol=1e-9)
    missing |= _masked(path, picture, values.shape, remarks)
    heights = np.where(missing, np.nan, _metres(path, values, tags, keys, remarks))
    return _map(path, heights, sizes, tuple(remarks))


def _cells(
    path: Path, tags: Any, keys: dict[int, int], cell: float | None, remarks: list[str]
) -> tuple[float, float]:
    """Return the width and the depth of a pixel, metres."""
    if keys.get(_MODEL) == _GEOGRAPHIC:
        raise SceneError(f"{path}: its cells are degrees, not metres", fix=_PROJECT)
    if cell is not None:
        return cell, cell
    if keys.get(_PROJECTED) in _MERCATORS:
        raise SceneError(
            f"{path}: its cells are longer than metres on the ground: they are of Mercator's "
            f"projection (EPSG:{keys[_PROJECTED]})",
            fix=_PROJECT,
        )
    sizes = _cell_of(path, tags, _unit(path, keys.get(_LINEAR, 9001), "cells", remarks))
    if sizes is None:
        raise UsageError(
            f"{path}: the file does not say how wide a pixel is",
            fix="give it, metres: --cell 0.04",
        )
    return sizes


def _metres(
    path: Path, values: NDArray[np.float64], tags: Any, keys: dict[int, int], remarks: list[str]
) -> NDArray[np.float64]:
    """Return the heights that numbers mean, by scale, offset and unit."""
    scale, offset, unit = _band(path, tags)
    if (scale, offset) != (1.0, 0.0):
        remarks.append(f"its heights are {scale:g} times its numbers, plus {offset:g}")
    code = keys.get(_VERTICAL, _DATUMS.get(keys.get(_DATUM, 0), unit))
    if unit not in {None, code}:
        raise SceneError(
            f"{path}: its unit of heights is EPSG code {code} by one tag and {unit} by another",
            fix="write it in metres",
        )
    level = _unit(path, 9001 if code is None else code, "heights", remarks)
    return (values * scale + offset) * level


def _band(path: Path, tags: Any) -> tuple[float, float, int | None]:
    """Return scale and offset of the numbers, and the EPSG code of their unit where it is said.

    Raises:
        SceneError: one of them cannot be used.
    """
    text = str(tags.get(_METADATA, "")).strip("\0 ")
    items: dict[str, str] = {}
    if text and len(text) <= _LONGEST and "<!" not in text:
        for item in fromstring(text).iter("Item"):  # noqa: S314 - It has no entities.
            if item.get("sample", "0") == "0" and item.get("role") in {
                "scale",
                "offset",
                "unittype",
            }:
                items[str(item.get("role"))] = (item.text or "").strip()
    elif text:
        raise SceneError(f"{path}: its metadata (tag 42112) are damaged", fix="export it again")
    numbers: list[float] = []
    for role, usual in (("scale", 1.0), ("offset", 0.0)):
        try:
            numbers.append(float(items.get(role, usual)))
        except ValueError:
            numbers.append(math.nan)
        if not math.isfinite(numbers[-1]) or (role == "scale" and not numbers[-1]):
            raise SceneError(
                f"{path}: the {role} of its heights cannot be {clean(items[role], at_most=20)!r}",
                fix="export it again",
            )
    unit = items.get("unittype") or None
    if unit is not None and unit.lower() not in _NAMED_UNITS:
        raise SceneError(
            f"{path}: the unit of its heights, {clean(unit, at_most=40)!r}, is not known here",
            fix="write it in metres",
        )
    return numbers[0], numbers[1], None if unit is None else _NAMED_UNITS[unit.lower()]


def _masked(
    path: Path, picture: Image, shape: tuple[int, ...], remarks: list[str]
) -> NDArray[np.bool_]:
    """Return which pixels the file's page of a mask calls no ground; other pages are noted."""
    masked = np.zeros(shape, np.bool_)
    pages = int(getattr(picture, "n_frames", 1))
    for page in range(1, min(pages, _PAGES)):
        picture.seek(page)
        tags: Any = getattr(picture, "tag_v2", {})
        kind = int(tags.get(_PAGE, 0))
        if kind & _OVERVIEW:  # A smaller copy, or the mask of one.
            continue
        if not kind & _MASK:
            remarks.append(f"not read: page {page + 1} of the file")
            continue
        if picture.size != shape[::-1]:
            raise SceneError(
                f"{path}: its mask is of {picture.size[0]} x {picture.size[1]} pixels, not of "
                f"{shape[1]} x {shape[0]}",
                fix="export it again",
            )
        masked |= np.asarray(picture.convert("L")) == 0
    if pages > _PAGES:
        remarks.append(f"not read: pages after {_PAGES} of the file")
    return masked


def _map(
    path: Path, heights: NDArray[np.float64], cell: tuple[float, float], remarks: tuple[str, ...]
) -> ElevationMap:
    known = np.isfinite(heights)
    if not known.any():
        raise SceneError(f"{path}: no pixel has a height", fix="check --no-data")
    highest = float(np.abs(heights[known]).max())
    if highest > _HIGHEST:
        raise SceneError(
            f"{path}: a pixel is at {highest:.3g} m, which is not a height",
            fix="if that means no ground, name it: --no-data",
        )
    if not known.all():
        share = 100.0 * float((~known).mean())
        remarks = (*remarks, f"{share:.1f} % of the pixels have no ground, and are holes")
    return ElevationMap(heights=heights, cell=cell, findings=remarks)


def _geo_keys(tags: Any) -> dict[int, int]:
    """Return the keys of a GeoKeyDirectory whose values stand in it: rows of four numbers."""
    numbers = [int(number) for number in tags.get(_GEO_KEYS, ())]
    rows = [numbers[i : i + 4] for i in range(4, len(numbers) - 3, 4)]
    return {key: value for key, where, _, value in rows if where == 0}


def _unit(path: Path, code: int, what: str, remarks: list[str]) -> float:
    if code not in _UNITS:
        raise SceneError(
            f"{path}: the unit of its {what} has the EPSG code {code}, which is not known here",
            fix="write it in metres",
        )
    if code != 9001:
        remarks.append(f"its {what} are in feet of {_UNITS[code]:.7g} m")
    return _UNITS[code]


def _cell_of(path: Path, tags: Any, unit: float) -> tuple[float, float] | None:
    """Return the width and the depth of a pixel, metres, as the tags say them."""
    if _PIXEL_SCALE in tags:
        x, y = (float(number) * unit for number in tags[_PIXEL_SCALE][:2])
    elif _TRANSFORMATION in tags:
        a, b, _, _, d, e = (float(number) for number in tags[_TRANSFORMATION][:6])
        if abs(b) > 1e-9 * abs(a) or abs(d) > 1e-9 * abs(e):
            raise SceneError(f"{path}: its rows are turned", fix="warp it so that north is up")
        x, y = a * unit, -e * unit
    else:
        return None
    if x < 0.0 or y < 0.0:
        raise SceneError(
            f"{path}: its first row is the southernmost, or its columns run to the west",
            fix="warp it so that north is up",
        )
    if not (0.0 < x < 1e6 and 0.0 < y < 1e6):
        raise SceneError(f"{path}: pixels of {x:g} x {y:g} m", fix="give --cell")
    return x, y


def elevation_mesh(elevation: ElevationMap) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return vertices (V, 3), metres, and faces (F, 3) that look up, of an elevation map.

    A vertex lies at the middle of each pixel: x goes with the columns, y against the rows, and the
    lower left pixel is at (0, 0). A square without all four heights has no faces, or one of three.
    """
    rows, columns = elevation.heights.shape
    x = np.arange(columns) * elevation.cell[0]
    y = np.arange(rows)[::-1] * elevation.cell[1]
    grid = np.stack([*np.broadcast_arrays(x[None, :], y[:, None]), elevation.heights], axis=-1)
    number = np.arange(rows * columns).reshape(rows, columns)
    upper_left, upper_right = number[:-1, :-1].ravel(), number[:-1, 1:].ravel()
    left, right = number[1:, :-1].ravel(), number[1:, 1:].ravel()
    known = np.isfinite(elevation.heights).ravel()
    z = elevation.heights.ravel()
    # The square is divided along the diagonal that bends less.
    rising = np.abs(z[left] - z[upper_right]) <= np.abs(z[upper_left] - z[right])
    rising |= ~(known[upper_left] & known[right])
    one = np.where(rising[:, None], np.stack([left, right, upper_right], -1),
                   np.stack([left, right, upper_left], -1))  # fmt: skip
    two = np.where(rising[:, None], np.stack([left, upper_right, upper_left], -1),
                   np.stack([right, upper_right, upper_left], -1))  # fmt: skip
    faces = np.stack([one, two], axis=1).reshape(-1, 3)
    faces = faces[known[faces].all(axis=1)]
    needed, places = np.unique(faces, return_inverse=True)
    return grid.reshape(-1, 3)[needed], places.reshape(-1, 3)
