"""Scores of one plane of a sweep."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nw_eval.machine_code.jit import kernel

COST = 1000.0
"""Cost of the worst match in a volume of costs, which holds whole numbers."""

NOISE = 2.0
"""Variance of a photograph's noise, grey levels squared: what varies less is not compared."""


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
def to_costs(firsts: Any, seconds: Any, place: Any, volume: Any) -> None:
    """Write the costs of a few planes into the volume.

    Args:
        firsts: (P, H, W) float32 scores, -1 to 1.
        seconds: likewise; the mean of both counts.
        place: of the first of these planes.
        volume: (H, W, D) uint16, out: 0 to `COST`.
    """
    half = np.float32(0.5 * COST)
    for y in range(volume.shape[0]):
        for x in range(volume.shape[1]):
            for p in range(firsts.shape[0]):
                mean = np.float32(0.5) * (firsts[p, y, x] + seconds[p, y, x])
                cost = half - half * min(max(mean, np.float32(-1.0)), np.float32(1.0))
                volume[y, x, place + p] = np.uint16(cost + np.float32(0.5))
