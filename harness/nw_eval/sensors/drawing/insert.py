"""Puts drawn objects into a picture of the scene: hidden as it hides, lit as it is lit.

The light on drawn objects, told from the picture that they are put into: gray world.

Nothing is known of a scanned scene's lamps; but what is photographed there reflects 18 % of its
light on average (Buchsbaum, "A spatial processor model for object colour perception", 1980, and
the grey card of photographers). So the mean colour of the ground around an object tells how bright
and of which colour the light is there.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from nw_eval.scenes.rays import RayScene
from nw_eval.sensors.drawing.overlay import Overlay
from nw_eval.splat.image import Image, composite

Floats = NDArray[np.floating]

_LOOSE = 0.05
"""Metres: so near to a surface of the geometry, above or below, the splat shows that surface."""

_GREY = 0.46
"""Display value (sRGB) of what reflects 18 %."""
_TINT = 0.35
"""Share of the mean's tint that is the light's; the rest is of the surfaces themselves."""
_CELLS = (9, 16)
"""Rows and columns in which means are taken."""
_SAMPLES = 45
"""Rows and columns of pixels that are looked at, at least; more say nothing new about a mean."""
_LEVEL = 0.02
"""Rays that go down less steeply than this see what is far away, or sky."""
_LUMA = np.array([0.2126, 0.7152, 0.0722])


def insert(
    image: Image,
    overlay: Overlay,
    *,
    directions: NDArray[np.float64],
    T_world_camera: NDArray[np.float64],
    static: RayScene,
) -> Image:
    """Blend drawn objects, of which geometry hides nothing more, into a picture of the splat.

    The splat hides them too, where it shows what the geometry lacks, such as grass or a pole. Its
    depth has noise, a few centimetres along a slanting ray: where it comes to lie near a surface,
    it is that surface, and about that the geometry has been asked.

    Args:
        image: rendered, depth in m.
        overlay: at the same pixels, from `overlay.draw` with `static`.
        directions: (H, W, 3) from `ray_directions`.
        T_world_camera: (4, 4), a rotation and metres; or (H, 4, 4), one for each row.
        static: the scene's geometry.
    """
    row, column = np.nonzero(overlay.coverage)
    if len(row) == 0:
        return image
    drawn = overlay.depth[row, column]
    depth = image.depth[row, column]
    before = np.flatnonzero(depth < drawn)
    rays = directions[row[before], column[before]]
    along = depth[before].astype(np.float64) / rays[:, 2]
    seen = rays * along[:, np.newaxis]
    if T_world_camera.ndim == 2:
        points = seen @ T_world_camera[:3, :3].T + T_world_camera[:3, 3]
        down = directions @ -T_world_camera[2, :3]
    else:
        T = T_world_camera[row[before]]
        points = (T[:, :3, :3] @ seen[..., np.newaxis])[..., 0] + T[:, :3, 3]
        down = -(directions * T_world_camera[:, np.newaxis, 2, :3]).sum(axis=-1)
    surface = before[_beside_surface(points, static)]
    depth[surface] = np.nextafter(drawn[surface], np.float32(np.inf))
    light = light_around(image.rgb, down, row, column)
    if overlay.lit is not None:
        light = 1.0 + (light - 1.0) * overlay.lit[row, column, np.newaxis]
    blended = composite(
        Image(
            rgb=image.rgb[row, column][np.newaxis],
            depth=depth[np.newaxis],
            alpha=image.alpha[row, column][np.newaxis],
        ),
        (overlay.rgb[row, column] * light)[np.newaxis],
        drawn[np.newaxis],
        overlay.coverage[row, column][np.newaxis],
    )
    new = Image(rgb=image.rgb.copy(), depth=image.depth.copy(), alpha=image.alpha.copy())
    new.rgb[row, column] = blended.rgb[0]
    new.depth[row, column] = blended.depth[0]
    new.alpha[row, column] = blended.alpha[0]
    return new


def _beside_surface(points: NDArray[np.float64], static: RayScene) -> NDArray[np.bool_]:
    """Return which points (N, 3) have a surface at most `_LOOSE` above or below them."""
    down = np.zeros_like(points)
    down[:, 2] = -1.0
    return static.distance(points + np.array([0.0, 0.0, _LOOSE]), down) < 2.0 * _LOOSE


_DIMMEST, _BRIGHTEST = 0.15, 1.1
_ELSEWHERE, _AFAR = 1e-4, 1e-2
"""Weights beside that of ground around: of what is no ground, and of ground anywhere else."""


def light_around(
    rgb: Floats, down: Floats, row: NDArray[np.intp], column: NDArray[np.intp]
) -> NDArray[np.float32]:
    """Return the factors that light puts on display values of objects at some pixels.

    Display values are about powers of light, and powers keep products: the ratio of display values
    is that factor, without decoding them.

    Args:
        rgb: (H, W, 3) picture without the objects, display values.
        down: (H, W) how far down the pixels' rays go in each metre.
        row: (N,) of the pixels.
        column: (N,) of the pixels.

    Returns:
        (N, 3), 1 where the ground is an average grey.
    """
    step = tuple(slice(None, None, max(1, size // _SAMPLES)) for size in rgb.shape[:2])
    weight = np.where(down[step] > _LEVEL, 1.0, _ELSEWHERE)[..., np.newaxis]
    weighed = np.empty((*weight.shape[:2], 4))
    np.multiply(np.clip(rgb[step], 0.0, 1.0), weight, out=weighed[..., :3])
    weighed[..., 3:] = weight
    cells = _cells(weighed)
    total = _around(cells) + _AFAR * cells.sum(axis=(0, 1))
    mean = _between(total[..., :3] / total[..., 3:], rgb.shape[:2], row, column)
    grey = (mean * _LUMA).sum(axis=-1, keepdims=True)
    brightness = np.clip(grey / _GREY, _DIMMEST, _BRIGHTEST)
    tint = 1.0 + _TINT * (mean / np.maximum(grey, 1e-3) - 1.0)
    return (brightness * tint).astype(np.float32)


def _cells(image: Floats) -> Floats:
    """Return sums over about `_CELLS` equal parts of an image (H, W, C)."""
    for axis, count in enumerate(_CELLS):
        image = np.add.reduceat(image, _starts(image.shape[axis], count), axis=axis)
    return image


def _starts(size: int, count: int) -> NDArray[np.intp]:
    count = min(size, count)
    return np.arange(count) * size // count


def _around(cells: Floats) -> Floats:
    """Return each cell of (R, C, K) with its neighbours: the next counts 2/3, the second 1/3."""
    rows, columns = (_weights(count) for count in cells.shape[:2])
    return np.moveaxis(rows @ np.moveaxis(cells, 2, 0) @ columns, 0, 2)


@cache
def _weights(count: int) -> Floats:
    index = np.arange(count)
    return np.maximum(3.0 - np.abs(index - index[:, np.newaxis]), 0.0)


def _between(
    cells: Floats, shape: tuple[int, int], row: NDArray[np.intp], column: NDArray[np.intp]
) -> Floats:
    """Return values (N, K) at pixels, interpolated between the cells' middles."""
    low: list[NDArray[np.intp]] = []
    share: list[Floats] = []
    for axis, index in enumerate((row, column)):
        count = cells.shape[axis]
        at = np.clip((index + 0.5) * count / shape[axis] - 0.5, 0.0, count - 1.0)
        low.append(np.minimum(at.astype(np.intp), max(count - 2, 0)))
        share.append((at - low[-1])[:, np.newaxis])
    (i, j), (v, u) = low, share
    k, m = np.minimum(i + 1, cells.shape[0] - 1), np.minimum(j + 1, cells.shape[1] - 1)
    upper = (1.0 - u) * cells[i, j] + u * cells[i, m]
    lower = (1.0 - u) * cells[k, j] + u * cells[k, m]
    return (1.0 - v) * upper + v * lower
