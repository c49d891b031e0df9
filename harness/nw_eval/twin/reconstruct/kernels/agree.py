"""Depth maps that see the same surface."""

from __future__ import annotations

from typing import Any

import numpy as np

from nw_eval.machine_code.jit import kernel


@kernel
def count_agreeing(
    depth: Any, other: Any, move: Any, shift: Any, tolerance: Any, count: Any
) -> None:
    """Count one for each pixel that a second depth map says the same of.

    Args:
        depth: (H, W) float32, 0 where not known.
        other: (h, w) float32, likewise.
        move: (3, 3) float64: K' R K^-1, pixels times depth of the first to the second's.
        shift: (3,) float64: K' t.
        tolerance: largest difference, a share of the depth.
        count: (H, W) uint8, in and out.
    """
    height, width = other.shape
    for y in range(depth.shape[0]):
        for x in range(depth.shape[1]):
            d = float(depth[y, x])
            if d <= 0.0:
                continue
            u, v = x + 0.5, y + 0.5
            c = d * (move[2, 0] * u + move[2, 1] * v + move[2, 2]) + shift[2]
            if c <= 0.0:
                continue
            a = (d * (move[0, 0] * u + move[0, 1] * v + move[0, 2]) + shift[0]) / c
            b = (d * (move[1, 0] * u + move[1, 1] * v + move[1, 2]) + shift[1]) / c
            if not (0.0 <= a < width and 0.0 <= b < height):
                continue
            seen = float(other[int(b), int(a)])
            if seen > 0.0 and abs(seen - c) <= tolerance * c:
                count[y, x] += np.uint8(1)
