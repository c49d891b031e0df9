"""Structural similarity of two pictures and its gradient, plane by plane, in bands of rows.

Wang, Bovik, Sheikh and Simoncelli 2004, with the window that the 3DGS paper trains with: 11x11,
Gaussian of 1.5 pixels, zeros beyond the edges. With m the window's mean,

    S = (2 mx my + c1) (2 sxy + c2) / ((mx^2 + my^2 + c1) (sxx + syy + c2)).

S at a pixel moves with mx, m(x^2) and m(xy); the window is symmetric, so that the gradient with
respect to x is the window's mean of the three slopes, times 1, 2 x and y.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from nw_eval.machine_code import inlined
from nw_eval.splat.kernels.memory import load, store
from nw_eval.splat.kernels.simd import fma
from nw_eval.twin.gaussians.kernels.jit import kernel

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
