"""Loops over the rows of Gaussians and of pictures.

Of Gaussians: the optimiser's step, nearest neighbours, and MCMC's noise. The optimiser is Adam
(Kingma and Ba 2015, algorithm 1) over rows of float32.

Of pictures: structural similarity of two and its gradient, plane by plane, in bands of rows. Wang,
Bovik, Sheikh and Simoncelli 2004, with the window that the 3DGS paper trains with: 11x11, Gaussian
of 1.5 pixels, zeros beyond the edges. With m the window's mean,

    S = (2 mx my + c1) (2 sxy + c2) / ((mx^2 + my^2 + c1) (sxx + syy + c2)).

S at a pixel moves with mx, m(x^2) and m(xy); the window is symmetric, so that the gradient with
respect to x is the window's mean of the three slopes, times 1, 2 x and y.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nw_base.machine_code import inlined
from nw_base.simd.lanes import fma
from nw_base.simd.memory import load, store
from nw_twin.gaussians.kernels import kernel
from nw_twin.gaussians.kernels.project import rotation

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


RADIUS = 5
SLOPES = 3
"""Maps of slopes for each plane: of mx, m(x^2) and m(xy)."""

C1, C2 = 0.01**2, 0.03**2


@inlined
def _along(values: Any, place: Any, step: Any, weights: Any, first: Any, end: Any) -> Any:
    """Return the weighted sum of eight lanes at place, place + step, ..: taps first..end-1."""
    total = load(values, place + first * step) * weights[first]
    for k in range(first + 1, end):
        total = fma(load(values, place + k * step), weights[k], total)
    return total


@inlined
def _rows_across(padded: Any, count: Any, stride: Any, width: Any, weights: Any, out: Any) -> None:
    """Filter `count` rows along themselves; `padded` has them behind RADIUS zeros each."""
    for m in range(count):
        for column in range(0, width, 8):
            place = m * stride + column
            store(out, place, _along(padded, place, 1, weights, 0, 2 * RADIUS + 1))


@kernel
def ssim_slopes(
    x: Any, y: Any, weights: Any, first: Any, end: Any, stride: Any, slopes: Any, sums: Any
) -> None:
    """Write S's sums and slopes for rows first..end-1 of a plane.

    Args:
        x: (H, W) float32, what is to move.
        y: (H, W) float32, what it is compared with.
        weights: (11,) float32, the window along one axis.
        first: first row.
        end: behind the last one.
        stride: floats in a row of the slopes: at least W + 16, a multiple of 8.
        slopes: (3 * H * stride,) float32, out: row by row, three slopes each.
        sums: (H,) float64, out: sum of S along each row.
    """
    height, width = x.shape
    low, high = max(first - RADIUS, 0), min(end + RADIUS, height)
    padded = np.zeros(5 * stride, np.float32)
    across = np.empty((high - low) * 5 * stride, np.float32)
    similar = np.empty(stride, np.float32)
    for row in range(low, high):
        for column in range(width):
            a, b = x[row, column], y[row, column]
            place = RADIUS + column
            padded[place] = a
            padded[stride + place] = b
            padded[2 * stride + place] = a * a
            padded[3 * stride + place] = b * b
            padded[4 * stride + place] = a * b
        start = (row - low) * 5 * stride
        _rows_across(padded, 5, stride, width, weights, across[start:])
    step = 5 * stride
    c1, c2 = np.float32(C1), np.float32(C2)
    for row in range(first, end):
        a, b = max(0, RADIUS - row), min(2 * RADIUS + 1, height + RADIUS - row)
        for column in range(0, width, 8):
            place = (row - RADIUS - low) * step + column
            mx = _along(across, place, step, weights, a, b)
            my = _along(across, place + stride, step, weights, a, b)
            xx = _along(across, place + 2 * stride, step, weights, a, b) - mx * mx
            yy = _along(across, place + 3 * stride, step, weights, a, b) - my * my
            xy = _along(across, place + 4 * stride, step, weights, a, b) - mx * my
            top1, top2 = fma(mx * my, 2.0, c1), fma(xy, 2.0, c2)
            low1, low2 = mx * mx + my * my + c1, xx + yy + c2
            scale = 1.0 / (low1 * low2)
            s = top1 * top2 * scale
            by_xx, by_xy = -1.0 * s / low2, 2.0 * top1 * scale
            by_mean = 2.0 * (my * top2 * scale - mx * s / low1)
            by_mean = by_mean - 2.0 * mx * by_xx - my * by_xy
            out = row * SLOPES * stride + column
            store(similar, column, s)
            store(slopes, out, by_mean)
            store(slopes, out + stride, by_xx)
            store(slopes, out + 2 * stride, by_xy)
        total = 0.0
        for column in range(width):
            total += similar[column]
        sums[row] = total


@kernel
def photo_gradient(
    x: Any,
    y: Any,
    weights: Any,
    first: Any,
    end: Any,
    stride: Any,
    slopes: Any,
    scales: Any,
    out: Any,
    sums: Any,
) -> None:
    """Write the gradient of scales[0] sum |x - y| + scales[1] sum S for some rows of a plane.

    Args:
        x: (H, W) float32.
        y: (H, W) float32.
        weights: (11,) float32.
        first: first row.
        end: behind the last one.
        stride: as in `ssim_slopes`.
        slopes: of `ssim_slopes`, all rows.
        scales: (2,) float32.
        out: (H, W) float32, out.
        sums: (H,) float64, out: sum of |x - y| along each row.
    """
    height, width = x.shape
    low, high = max(first - RADIUS, 0), min(end + RADIUS, height)
    padded = np.zeros(SLOPES * stride, np.float32)
    across = np.empty((high - low) * SLOPES * stride, np.float32)
    means = np.empty(SLOPES * stride, np.float32)
    step = SLOPES * stride
    for row in range(low, high):
        for m in range(SLOPES):
            for column in range(width):
                padded[m * stride + RADIUS + column] = slopes[row * step + m * stride + column]
        _rows_across(padded, SLOPES, stride, width, weights, across[(row - low) * step :])
    two, nil = np.float32(2), np.float32(0)
    for row in range(first, end):
        a, b = max(0, RADIUS - row), min(2 * RADIUS + 1, height + RADIUS - row)
        for m in range(SLOPES):
            for column in range(0, width, 8):
                place = (row - RADIUS - low) * step + m * stride + column
                store(means, m * stride + column, _along(across, place, step, weights, a, b))
        total = 0.0
        for column in range(width):
            value, wanted = x[row, column], y[row, column]
            similar = means[column] + two * value * means[stride + column]
            similar += wanted * means[2 * stride + column]
            apart = value - wanted
            sign = scales[0] if apart > nil else (-scales[0] if apart < nil else nil)
            out[row, column] = sign + scales[1] * similar
            total += abs(apart)
        sums[row] = total
