"""The compiled loops of planes: which plane each pixel shows, and depth maps that agree.

What speaks for each plane is counted, and labels seldom change. None of it knows of files.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nw_eval.machine_code import inlined, kernel

COST = 1000.0
"""Cost of 1 in a volume of costs, which holds whole numbers."""

NOISE = 2.0
"""Variance of a photograph's noise, grey levels squared: what varies less is not compared."""

_NEAR = 0.03
"""Share of its depth within which a surface is the one that is seen there."""


@kernel
def count_agreeing(
    depth: Any, other: Any, move: Any, shift: Any, tolerance: Any, count: Any
) -> None:
    """Count one for each pixel that a second depth map says the same of.

    Args:
        depth: (H, W) float32, 0 where not known.
        other: (h, w) float32, as above.
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


@kernel
def count_seen(depth: Any, other: Any, move: Any, shift: Any, seen: Any, through: Any) -> None:
    """Count for each pixel whether a second depth map sees its surface, or looks through it.

    Args:
        depth: (H, W) float32, 0 where not known.
        other: (h, w) float32, as above.
        move: (3, 3) float64: K' R K^-1, pixels times depth of the first to the second's.
        shift: (3,) float64: K' t.
        seen: (H, W) uint8, in and out.
        through: (H, W) uint8, in and out: what is farther was seen there.
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
            there = float(other[int(b), int(a)])
            if there > c * (1.0 + _NEAR):
                through[y, x] += np.uint8(1)
            elif there > c * (1.0 - _NEAR):
                seen[y, x] += np.uint8(1)


@kernel
def keep_best(
    own: Any, own_mean: Any, product: Any, square: Any, mean: Any, first: Any, second: Any
) -> None:
    """Compare a picture with a warped neighbour and keep each pixel's two best scores.

    Args:
        own: (H, W) float32, 1 / standard deviation of the picture's windows.
        own_mean: (H, W) float32, their mean.
        product: (H, W) float32, mean of picture times neighbour.
        square: (H, W) float32, mean of the neighbour's square.
        mean: (H, W) float32, mean of the neighbour.
        first: (H, W) float32, in and out: the best normalised cross correlation so far.
        second: (H, W) float32, in and out: the second best.
    """
    noise = np.float32(NOISE)
    for y in range(own.shape[0]):
        for x in range(own.shape[1]):
            m = mean[y, x]
            spread = max(square[y, x] - m * m, np.float32(0.0))
            share = product[y, x] - own_mean[y, x] * m
            score = share * own[y, x] / np.float32(math.sqrt(spread + noise))
            low = min(score, first[y, x])
            first[y, x] = max(score, first[y, x])
            second[y, x] = max(low, second[y, x])


@kernel
def keep_least(values: Any, first: Any, second: Any) -> None:
    """Keep each pixel's two least values.

    Args:
        values: (H, W) float32.
        first: (H, W) float32, in and out: the least so far.
        second: (H, W) float32, in and out: the second.
    """
    for y in range(values.shape[0]):
        for x in range(values.shape[1]):
            high = max(values[y, x], first[y, x])
            first[y, x] = min(values[y, x], first[y, x])
            second[y, x] = min(high, second[y, x])


@kernel
def agree(volume: Any, grey: Any, jump: Any, total: Any) -> None:
    """Sum costs along eight paths on which labels seldom change, (Hirschmueller, 2008).

    Costs are whole numbers in single precision: their sums are exact.

    Args:
        volume: (H, W, L) uint16 costs of the labels.
        grey: (H, W) float32: where it changes, a label may change at less cost.
        jump: cost of another label than the pixel's before.
        total: (H, W, L) float32, zero before.
    """
    height, width, count = volume.shape
    rows = np.zeros((2, width + 2, count), np.float32)
    for backwards in range(2):
        for sideways in range(-1, 2):
            rows[:] = 0.0
            for n in range(height):
                y = height - 1 - n if backwards else n
                came = y + 1 if backwards else y - 1
                for x in range(width):
                    from_x = x - sideways
                    inside = n > 0 and 0 <= from_x < width
                    change = _jump(jump, grey, y, x, came, from_x) if inside else np.float32(0.0)
                    _step(
                        volume[y, x], total[y, x], rows[1 - n % 2, from_x + 1],
                        rows[n % 2, x + 1], change, inside,
                    )  # fmt: skip
        for y in range(height):
            for n in range(width):
                x = width - 1 - n if backwards else n
                came = x + 1 if backwards else x - 1
                inside = n > 0
                change = _jump(jump, grey, y, x, y, came) if inside else np.float32(0.0)
                _step(volume[y, x], total[y, x], rows[0, came + 1], rows[0, x + 1], change, inside)


@inlined
def _step(costs: Any, total: Any, before: Any, after: Any, change: Any, inside: Any) -> None:
    count = costs.shape[0]
    if not inside:
        for k in range(count):
            after[k] = np.float32(costs[k])
            total[k] += after[k]
        return
    least = before[0]
    for k in range(1, count):
        least = min(least, before[k])
    for k in range(count):
        path = np.float32(costs[k]) + min(before[k] - least, change)
        after[k] = path
        total[k] += path


@inlined
def _jump(jump: Any, grey: Any, y: Any, x: Any, from_y: Any, from_x: Any) -> Any:
    """Return what another label costs between two pixels: less, the more they differ."""
    change = np.float32(abs(grey[y, x] - grey[from_y, from_x]))
    return np.float32(int(np.float32(jump) / (np.float32(1.0) + change * np.float32(0.4))))
