"""A place from straight above: the mesh that a log holds, drawn small."""

from __future__ import annotations

from io import BytesIO

import numpy as np
from numpy.typing import NDArray

Box = tuple[float, float, float, float]
"""West, south, east, north: metres in the world frame."""

MARGIN = 2.0
"""Metres round the trail; a robot that is farther from it is off its course."""

_SIDE = 480  # pixels of the longer side
_FINER = 2  # It is drawn so many times larger, and then made smaller for smooth edges.
_MOST_TRIANGLES = 300_000  # in the picture; those of the built-in places have some thousand
# Heights against the ground at the start, m, and their greys: pits are dark, and what stands up is
# darker the higher it is. Obstacles of a legged robot are low, so most greys are spent on those.
_HEIGHTS, _GREYS = (-0.6, 0.0, 0.3, 1.2), (120, 232, 176, 104)
_LEANS = 0.2  # of its grey that a vertical face loses
_QUALITIES = (60, 30, 10)


def box_round(points: NDArray[np.floating]) -> Box:
    """Return the box of some points, (n, 2) m, with a margin."""
    west, south = (points.min(axis=0) - MARGIN).tolist()
    east, north = (points.max(axis=0) + MARGIN).tolist()
    return west, south, east, north


def picture_from_above(
    triangles: NDArray[np.floating], box: Box, *, ground: float, most_bytes: int
) -> bytes:
    """Return a WebP of a mesh; empty where there is nothing to draw, or no room for it.

    Args:
        triangles: corners, (n, 3, 3) m, of all but what hangs overhead.
        box: what the picture shows.
        ground: height of the start, m.
        most_bytes: that the file may have.
    """
    from PIL import Image, ImageDraw

    west, south, east, north = box
    seen = _seen(triangles, box)
    if not 0 < len(seen) <= _MOST_TRIANGLES:
        return b""
    scale = _FINER * _SIDE / max(east - west, north - south)  # pixels in a metre
    width, height = ((east - west) * scale, (north - south) * scale)
    picture = Image.new("L", (max(_FINER, round(width)), max(_FINER, round(height))), 255)
    brush = ImageDraw.Draw(picture)
    corners = (seen[:, :, :2] - (west, north)) * (scale, -scale)
    # The painter's way: what lies lower first. Faces of a place hardly cut through each other.
    for corner, grey in zip(
        corners.reshape(-1, 6).tolist(), _greys(seen, ground).tolist(), strict=True
    ):
        brush.polygon(corner, fill=grey)
    small = picture.reduce(_FINER)
    for quality in _QUALITIES:
        file = BytesIO()
        small.save(file, "WEBP", quality=quality)
        if file.tell() <= most_bytes:
            return file.getvalue()
    return b""


def _seen(triangles: NDArray[np.floating], box: Box) -> NDArray[np.floating]:
    """Return the triangles that lie in the box, the lower ones first; walls have no area there."""
    west, south, east, north = box
    flat = triangles[:, :, :2]
    near = (flat.min(axis=1) < (east, north)).all(axis=1)
    near &= (flat.max(axis=1) > (west, south)).all(axis=1)
    a, b = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    area = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    found = triangles[near & (area > 1e-6) & np.isfinite(triangles).all(axis=(1, 2))]
    return found[np.argsort(found[:, :, 2].mean(axis=1), kind="stable")]


def _greys(triangles: NDArray[np.floating], ground: float) -> NDArray[np.int64]:
    """Return a grey for each triangle, by its height and, a little, by how it leans."""
    grey = np.interp(triangles[:, :, 2].mean(axis=1) - ground, _HEIGHTS, _GREYS)
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    level = np.abs(normal[:, 2]) / np.linalg.norm(normal, axis=1)
    return np.rint(grey * (1.0 - _LEANS * (1.0 - level))).astype(np.int64)
