"""Puts drawn objects into a picture of the place: hidden as it hides, lit as it is lit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nw_eval.scenes.rays import RayScene
from nw_eval.sensors.drawing.light import light_around
from nw_eval.sensors.drawing.overlay import Overlay
from nw_eval.splat.image import Image, composite

_LOOSE = 0.05
"""Metres: so near to a surface of the geometry, above or below, the splat shows that surface."""


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
        T_world_camera: (4, 4), a rotation and metres.
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
    points = (rays * along[:, np.newaxis]) @ T_world_camera[:3, :3].T + T_world_camera[:3, 3]
    surface = before[_beside_surface(points, static)]
    depth[surface] = np.nextafter(drawn[surface], np.float32(np.inf))
    light = light_around(image.rgb, directions @ -T_world_camera[2, :3], row, column)
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
    down = np.broadcast_to([0.0, 0.0, -1.0], points.shape)
    return static.distance(points + np.array([0.0, 0.0, _LOOSE]), down) < 2.0 * _LOOSE
