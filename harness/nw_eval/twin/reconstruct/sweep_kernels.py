"""The compiled loops of a plane sweep: scores of each plane, and semi-global matching.

Semi-global matching: costs are summed along paths on which depth rarely changes.

Hirschmueller, "Stereo Processing by Semiglobal Matching and Mutual Information" (2008), with four
paths. Costs are whole numbers in single precision, which are exact: their sums do not depend on how
a machine adds them.

None of it knows of files.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nw_eval.machine_code.jit import inlined, kernel

COST = 1000.0
"""Cost of the worst match in a volume of costs, which holds whole numbers."""

NOISE = 2.0
"""Variance of a photograph's noise, grey levels squared: what varies less is not compared."""

_FAR = 1e9


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


@inlined
def _least(values: Any, count: Any, scratch: Any) -> Any:
    """Return the least of values[1 : count + 1], by halves: many lanes at once."""
    half = (count + 1) // 2
    for d in range(count - half):
        scratch[d] = min(values[d + 1], values[d + 1 + half])
    if count % 2:
        scratch[half - 1] = values[half]
    while half > 1:
        count = half
        half = (count + 1) // 2
        for d in range(count - half):
            scratch[d] = min(scratch[d], scratch[d + half])
    return scratch[0]


@inlined
def _advance(
    costs: Any, total: Any, before: Any, after: Any, scratch: Any, step: Any, jump: Any
) -> None:
    """Go one pixel along a path: costs (D,) and `before` (D + 2,) give `after`, and total."""
    count = costs.shape[0]
    least = _least(before, count, scratch)
    ceiling = least + jump
    for d in range(count):
        change = min(before[d], before[d + 2]) + step
        path = min(before[d + 1], change, ceiling) - least
        path += np.float32(costs[d])
        after[d + 1] = path
        total[d] += np.uint16(path)


@kernel
def smooth(volume: Any, grey: Any, step: Any, jump: Any, total: Any) -> None:
    """Sum costs along the four paths into `total`.

    Args:
        volume: (H, W, D) uint16 costs.
        grey: (H, W) float32: where it changes, depth may jump at less cost.
        step: cost of a change by one plane, a whole number.
        jump: of a larger one.
        total: (H, W, D) uint16, zero before.
    """
    height, width, count = volume.shape
    scratch = np.empty(count, np.float32)
    own_step = np.float32(step)
    for backwards in range(2):
        rows = np.full((2, count + 2), np.float32(_FAR))
        for y in range(height):
            rows[0, 1 : count + 1] = 0.0
            for n in range(width):
                x = width - 1 - n if backwards else n
                came = min(max(x + (1 if backwards else -1), 0), width - 1)
                own_jump = _jump(jump, step, grey[y, x], grey[y, came])
                _advance(
                    volume[y, x], total[y, x], rows[n % 2], rows[1 - n % 2], scratch,
                    own_step, own_jump,
                )  # fmt: skip
            rows[:, 1 : count + 1] = 0.0
    for backwards in range(2):
        paths = np.full((2, width, count + 2), np.float32(_FAR))
        paths[0, :, 1 : count + 1] = 0.0
        for n in range(height):
            y = height - 1 - n if backwards else n
            came = min(max(y + (1 if backwards else -1), 0), height - 1)
            for x in range(width):
                own_jump = _jump(jump, step, grey[y, x], grey[came, x])
                _advance(
                    volume[y, x], total[y, x], paths[n % 2, x], paths[1 - n % 2, x], scratch,
                    own_step, own_jump,
                )  # fmt: skip


@inlined
def _jump(jump: Any, step: Any, here: Any, there: Any) -> Any:
    """Return what a jump costs between two pixels: less, the more they differ."""
    change = np.float32(abs(here - there))
    lowered = np.float32(jump) / (np.float32(1.0) + change * np.float32(0.1))
    return np.float32(int(max(lowered, np.float32(step) * np.float32(1.5))))


@kernel
def winners(volume: Any, total: Any, plane: Any, likeness: Any, unique: Any) -> None:
    """Return each pixel's plane, between planes by a parabola.

    Args:
        volume: (H, W, D) uint16 costs.
        total: (H, W, D) uint16, of `smooth`.
        plane: (H, W) float32, out: 0 to D - 1.
        likeness: (H, W) float32, out: correlation at that plane.
        unique: (H, W) float32, out: how much worse all planes are that are no neighbours, a share
            of the worst cost.
    """
    height, width, count = volume.shape
    for y in range(height):
        for x in range(width):
            best = 0
            for d in range(1, count):
                if total[y, x, d] < total[y, x, best]:
                    best = d
            least = float(total[y, x, best])
            other = 1e9
            for d in range(count):
                if abs(d - best) > 2:  # Two planes to each side are the same dip.
                    other = min(other, float(total[y, x, d]))
            place = float(best)
            if 0 < best < count - 1:
                below = float(total[y, x, best - 1]) - least
                above = float(total[y, x, best + 1]) - least
                if below + above > 0.0:
                    place += 0.5 * (below - above) / (below + above)
            plane[y, x] = np.float32(place)
            likeness[y, x] = np.float32(1.0 - 2.0 * float(volume[y, x, best]) / COST)
            unique[y, x] = np.float32(min((other - least) / (4.0 * COST), 1.0))
