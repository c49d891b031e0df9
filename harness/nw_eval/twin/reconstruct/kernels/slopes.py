"""How surfaces of a depth map lean: inverse depth is linear across the picture of a plane."""

from __future__ import annotations

from typing import Any

import numpy as np

from nw_eval.machine_code.jit import inlined, kernel

_BEND = 0.01
"""Of inverse depths two pixels apart, a share: what bends more is no plane."""


@kernel
def slopes(depth: Any, out: Any) -> None:
    """Return how inverse depth changes across the picture, which is the same all over a plane.

    Args:
        depth: (H, W) float32, 0 where not known.
        out: (H, W, 2) float32, out: per pixel to the right and down; 0 where nobody knows.
    """
    height, width = depth.shape
    for y in range(height):
        for x in range(width):
            if depth[y, x] > 0.0:
                out[y, x, 0] = np.float32(_slope(depth, y, x, 0, 1))
                out[y, x, 1] = np.float32(_slope(depth, y, x, 1, 0))


@inlined
def _slope(depth: Any, y: Any, x: Any, down: Any, right: Any) -> Any:
    """Return the change of inverse depth per pixel one way: of both sides, or of one."""
    here = 1.0 / float(depth[y, x])
    for turn in range(3):
        first = -2 if turn != 1 else 0
        last = 2 if turn != 2 else 0
        middle = (first + last) // 2
        one = _inverse(depth, y + first * down, x + first * right)
        two = _inverse(depth, y + middle * down, x + middle * right)
        three = _inverse(depth, y + last * down, x + last * right)
        # What bends is another surface, or noise.
        if one > 0.0 and two > 0.0 and three > 0.0 and abs(one + three - 2.0 * two) < _BEND * here:
            return (three - one) / (last - first)
    return 0.0


@inlined
def _inverse(depth: Any, y: Any, x: Any) -> Any:
    """Return a pixel's inverse depth; 0 outside and where not known."""
    if not (0 <= y < depth.shape[0] and 0 <= x < depth.shape[1]):
        return 0.0
    d = float(depth[y, x])
    return 1.0 / d if d > 0.0 else 0.0
