"""Loops over the rows of Gaussians: the optimiser's step, nearest neighbours, and MCMC's noise.

The optimiser is Adam (Kingma and Ba 2015, algorithm 1) over rows of float32.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nw_eval.machine_code.jit import inlined
from nw_eval.twin.gaussians.kernels.jit import kernel
from nw_eval.twin.gaussians.kernels.project import rotation

BETA1, BETA2 = 0.9, 0.999

NEIGHBOURS = 3

STEEPNESS, FAINT = 100.0, 0.005
"""Of the curve that lets only faint Gaussians wander: 1 / (1 + exp(100 (opacity - 0.005)))."""


@inlined
def _move(
    values: Any, gradient: Any, mean: Any, square: Any, i: Any, k: Any, rate: Any, numbers: Any
) -> None:
    root, epsilon = numbers
    g = gradient[i, k]
    m = np.float32(BETA1) * mean[i, k] + np.float32(1.0 - BETA1) * g
    v = np.float32(BETA2) * square[i, k] + np.float32(1.0 - BETA2) * g * g
    mean[i, k], square[i, k] = m, v
    values[i, k] -= rate * m / (np.sqrt(v) * root + epsilon)


@kernel
def adam(
    arrays: Any,
    lead: Any,
    rates: Any,
    epsilon: Any,
    step: Any,
    first: Any,
    end: Any,
) -> None:
    """Move rows first..end-1.

    Args:
        arrays: values, gradient, first and second moments, each (N, W) float32; all but the
            gradient are changed.
        lead: columns that move at the first rate; the others move at the second.
        rates: (rate, rate).
        epsilon: added to the root of the second moment.
        step: steps taken, this one included.
        first: first row.
        end: behind the last one.
    """
    values, gradient, mean, square = arrays
    share = 1.0 - BETA1**step
    lead_rate, rest_rate = np.float32(rates[0] / share), np.float32(rates[1] / share)
    numbers = (np.float32(1.0 / math.sqrt(1.0 - BETA2**step)), np.float32(epsilon))
    for i in range(first, end):
        for k in range(lead):
            _move(values, gradient, mean, square, i, k, lead_rate, numbers)
        for k in range(lead, values.shape[1]):
            _move(values, gradient, mean, square, i, k, rest_rate, numbers)


@kernel
def mean_square_distances(points: Any, out: Any) -> None:
    """Write the mean squared distance to the three nearest others.

    Along x, no point further on can be nearer once the step along x alone is too far: of points on
    surfaces, some hundred are looked at each.

    Args:
        points: (N, 3) float64, N > 3, ascending in x.
        out: (N,) float64, out.
    """
    n = len(points)
    for i in range(n):
        a = b = c = np.inf  # Ascending: the nearest three so far.
        for direction in (-1, 1):
            j = i + direction
            while 0 <= j < n:
                dx = points[j, 0] - points[i, 0]
                if dx * dx >= c:
                    break
                dy, dz = points[j, 1] - points[i, 1], points[j, 2] - points[i, 2]
                d = dx * dx + dy * dy + dz * dz
                if d < a:
                    a, b, c = d, a, b
                elif d < b:
                    b, c = d, b
                elif d < c:
                    c = d
                j += direction
        out[i] = (a + b + c) / NEIGHBOURS


@kernel
def least_square_distances(points: Any, others: Any, out: Any) -> None:
    """Write the squared distance to the nearest of other points.

    Args:
        points: (N, 3) float64.
        others: (M, 3) float64, M > 0.
        out: (N,) float64, out.
    """
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        least = np.inf
        for j in range(len(others)):
            dx, dy, dz = others[j, 0] - x, others[j, 1] - y, others[j, 2] - z
            least = min(least, dx * dx + dy * dy + dz * dz)
        out[i] = least


@kernel
def perturb(means: Any, log_scales: Any, quats: Any, logits: Any, noise: Any, scale: Any) -> None:
    """Move each mean by its covariance times noise, the less the more opaque it is.

    What Kheradmand et al. 2024 add to each step: scale * curve(opacity) * Sigma * noise.

    Args:
        means: (N, 3) float32, moved.
        log_scales: (N, 3) float32.
        quats: (N, 4) float32.
        logits: (N,) float32.
        noise: (N, 3) float32, standard normal.
        scale: learning rate of the means times that of the noise.
    """
    for i in range(len(means)):
        opacity = 1.0 / (1.0 + math.exp(-float(logits[i])))
        share = scale / (1.0 + math.exp(min(STEEPNESS * (opacity - FAINT), 700.0)))
        r = rotation(quats[i])
        n0, n1, n2 = float(noise[i, 0]), float(noise[i, 1]), float(noise[i, 2])
        for axis in range(3):
            along = r[axis] * n0 + r[3 + axis] * n1 + r[6 + axis] * n2
            along *= share * math.exp(2.0 * float(log_scales[i, axis]))
            for k in range(3):
                means[i, k] += r[3 * k + axis] * along
