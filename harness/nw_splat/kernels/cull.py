"""Which chunks a window can see, and what part of it each may cover.

A chunk is 256 Gaussians with the bounds of their centres (an axis-aligned box) and their largest
standard deviation s. A Gaussian at depth z reaches at most 3.33 standard deviations of its
footprint from its centre, and the footprint's variance is at most (SPREAD s / z)**2 + eps2d. So
its pixels lie within REACH * SPREAD * s / z + REACH * sqrt(eps2d) of its centre. Multiplied by z
this is linear over the box, and the four sides of the window become planes to test it against.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nw_base.machine_code import inlined, kernel
from nw_splat.kernels import view as at

REACH = 3.33
"""Standard deviations beyond which even opacity 1 is below 1/255: sqrt(2 ln 255) = 3.329."""

BOUNDS = 8
"""Floats per chunk: centre (3), half extent (3), largest standard deviation, unused."""


@inlined
def _outside(a: Any, b: Any, c: Any, at_centre: Any, ex: Any, ey: Any, ez: Any) -> Any:
    """Tell whether a linear function with gradient (a, b, c) is negative over a whole box."""
    return at_centre + abs(a) * ex + abs(b) * ey + abs(c) * ez <= 0.0


@kernel
def visible_chunks(bounds: Any, view: Any, eps2d: Any, keys: Any, nearest: Any) -> Any:
    """Find the chunks that may draw into the window.

    Args:
        bounds: (chunks * BOUNDS,) float32.
        view: (SIZE,) float32 of view.py.
        eps2d: variance added to footprints, pixels squared.
        keys: (chunks,) int64, out: chunk numbers of the visible ones.
        nearest: (chunks,) float32, out: depth of the nearest point of each one's box, at least the
            near plane.

    Returns:
        How many are visible.
    """
    r = view[at.R : at.R + 9]
    fx, fy = view[at.FX], view[at.FY]
    blur = np.float32(REACH) * math.sqrt(eps2d) + np.float32(1.0)
    left = view[at.CX] - view[at.LEFT] + blur
    right = view[at.RIGHT] - view[at.CX] + blur
    top = view[at.CY] - view[at.TOP] + blur
    bottom = view[at.BOTTOM] - view[at.CY] + blur
    count = 0
    for chunk in range(len(bounds) // BOUNDS):
        b = bounds[chunk * BOUNDS : chunk * BOUNDS + BOUNDS]
        px, py, pz, ex, ey, ez = b[0], b[1], b[2], b[3], b[4], b[5]
        z = r[6] * px + r[7] * py + r[8] * pz + view[at.T + 2]
        half = abs(r[6]) * ex + abs(r[7]) * ey + abs(r[8]) * ez
        if z + half < view[at.NEAR] or z - half > view[at.FAR]:
            continue
        x = r[0] * px + r[1] * py + r[2] * pz + view[at.T]
        y = r[3] * px + r[4] * py + r[5] * pz + view[at.T + 1]
        reach_x = np.float32(REACH) * view[at.SPREAD_X] * b[6]
        reach_y = np.float32(REACH) * view[at.SPREAD_Y] * b[6]
        if (
            _outside(
                fx * r[0] + left * r[6],
                fx * r[1] + left * r[7],
                fx * r[2] + left * r[8],
                fx * x + left * z + reach_x,
                ex,
                ey,
                ez,
            )
            or _outside(
                right * r[6] - fx * r[0],
                right * r[7] - fx * r[1],
                right * r[8] - fx * r[2],
                right * z - fx * x + reach_x,
                ex,
                ey,
                ez,
            )
            or _outside(
                fy * r[3] + top * r[6],
                fy * r[4] + top * r[7],
                fy * r[5] + top * r[8],
                fy * y + top * z + reach_y,
                ex,
                ey,
                ez,
            )
            or _outside(
                bottom * r[6] - fy * r[3],
                bottom * r[7] - fy * r[4],
                bottom * r[8] - fy * r[5],
                bottom * z - fy * y + reach_y,
                ex,
                ey,
                ez,
            )
        ):
            continue
        keys[count] = chunk
        nearest[count] = max(z - half, view[at.NEAR])
        count += 1
    return count


@kernel
def is_hidden(
    bounds: Any, chunk: Any, view: Any, eps2d: Any, ray: Any, live: Any, live_stride: Any
) -> Any:
    """Tell whether every 8x8 block that a chunk may touch has only finished pixels.

    A box behind or around the camera touches everything. Otherwise the corners bound the box on
    the screen, since perspective keeps a convex body in front of the camera convex. Along the ray,
    a sphere of radius r at depth z and slope s ends r / z sqrt(1 + s**2) / (1 - r / z) further.

    Args:
        bounds: (chunks * BOUNDS,) float32.
        chunk: which one.
        view: (SIZE,) float32.
        eps2d: variance added to footprints, pixels squared.
        ray: None for EWA, anything else along the ray.
        live: unfinished pixels of each block of the window, row by row.
        live_stride: blocks per row of `live`.

    Returns:
        True when no pixel of the window could change.
    """
    b = bounds[chunk * BOUNDS : chunk * BOUNDS + BOUNDS]
    r = view[at.R : at.R + 9]
    least_z = np.float32(3.0e38)
    u0, u1 = np.float32(3.0e38), np.float32(-3.0e38)
    v0, v1 = np.float32(3.0e38), np.float32(-3.0e38)
    for corner in range(8):
        px = b[0] + (b[3] if corner & 1 else -b[3])
        py = b[1] + (b[4] if corner & 2 else -b[4])
        pz = b[2] + (b[5] if corner & 4 else -b[5])
        z = r[6] * px + r[7] * py + r[8] * pz + view[at.T + 2]
        if z <= view[at.NEAR]:
            return False
        u = view[at.FX] * (r[0] * px + r[1] * py + r[2] * pz + view[at.T]) / z + view[at.CX]
        v = view[at.FY] * (r[3] * px + r[4] * py + r[5] * pz + view[at.T + 1]) / z + view[at.CY]
        least_z = min(least_z, z)
        u0, u1, v0, v1 = min(u0, u), max(u1, u), min(v0, v), max(v1, v)
    one = np.float32(1.0)
    if ray is None:
        blur = np.float32(REACH) * math.sqrt(eps2d) + one
        reach_x = np.float32(REACH) * view[at.SPREAD_X] * b[6] / least_z + blur
        reach_y = np.float32(REACH) * view[at.SPREAD_Y] * b[6] / least_z + blur
    else:
        fx, fy, cx, cy = view[at.FX], view[at.FY], view[at.CX], view[at.CY]
        steepest = max(max(cx - u0, u1 - cx) / fx, max(cy - v0, v1 - cy) / fy, np.float32(0.0))
        slant = math.sqrt(one + np.float32(2.0) * steepest * steepest)
        scale = math.sqrt(r[6] * r[6] + r[7] * r[7] + r[8] * r[8])
        blur = math.sqrt(eps2d) / min(fx, fy) * slant
        near = np.float32(REACH) * (scale * b[6] / least_z + blur)
        if near > np.float32(0.9):
            return False
        reach = near * slant / (one - near)
        reach_x, reach_y = fx * reach + one, fy * reach + one
    column0 = _taken(view, u0 - reach_x, view[at.COLUMN0], view[at.COLUMN1])
    column1 = _taken(view, u1 + reach_x, view[at.COLUMN0], view[at.COLUMN1])
    row0 = _taken(view, v0 - reach_y, view[at.ROW0], view[at.ROW1])
    row1 = _taken(view, v1 + reach_y, view[at.ROW0], view[at.ROW1])
    for row in range(row0 >> 3, (row1 >> 3) + 1):
        for column in range(column0 >> 3, (column1 >> 3) + 1):
            if live[row * live_stride + column] > 0:
                return False
    return True


@inlined
def _taken(view: Any, pixel: Any, first: Any, end: Any) -> Any:
    """Return the window's taken-pixel index at or next before a pixel coordinate, clamped."""
    within = math.floor(pixel) - view[at.OFFSET]
    cell = math.floor((within + 0.5) * view[at.INVERSE_STRIDE])
    index = cell * view[at.BLOCK] + min(within - cell * view[at.STRIDE], view[at.BLOCK])
    return np.int64(max(min(index, end - 1.0), first) - first)
