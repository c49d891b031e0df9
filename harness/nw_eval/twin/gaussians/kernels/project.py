"""From Gaussians to the renderer's records, in double precision, one by one.

The formulas are those of the renderer's project.py (which see), with one difference: place 11 of a
record, which the blend treats as a fourth colour, holds 1 / z, so that the fourth picture is the
expected inverse depth sum_i w_i / z_i, which training compares with depth maps.

With M = R diag(s) and the rows t, u of J R_view, the footprint's covariance t' M M' t etc. is taken
as products of p = M' t and q = M' u: no covariance is formed, and none can lose its rank.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nw_eval.machine_code.jit import inlined
from nw_eval.splat.kernels import view as at
from nw_eval.splat.kernels.math8 import float_of
from nw_eval.splat.kernels.memory import poke
from nw_eval.splat.kernels.project import (
    COLUMNS,
    DEPTH,
    LOG_OPACITY,
    RECORD,
    RED,
    ROWS,
    THRESHOLD,
    A,
    B,
    C,
    U,
    V,
)
from nw_eval.twin.gaussians.kernels.ellipsoid import rotation
from nw_eval.twin.gaussians.kernels.harmonics import basis
from nw_eval.twin.gaussians.kernels.jit import kernel

INVERSE_DEPTH = DEPTH
"""Where a record of training has 1 / z."""

HALF_LOG2E = 0.5 * math.log2(math.e)
LN2 = math.log(2.0)
LEAST_KEPT = 1e-30
"""Least square of the antialiasing factor, as in the renderer."""

_WIDEN, _WIDEN_PIXELS = 1.00002, 0.002


@inlined
def camera_point(view: Any, mean: Any) -> Any:
    """Return a point as the camera sees it: x right, y down, z ahead, camera units."""
    dx = float(mean[0]) - view[at.EYE]
    dy = float(mean[1]) - view[at.EYE + 1]
    dz = float(mean[2]) - view[at.EYE + 2]
    r = view[at.R : at.R + 9]
    return (
        r[0] * dx + r[1] * dy + r[2] * dz,
        r[3] * dx + r[4] * dy + r[5] * dz,
        r[6] * dx + r[7] * dy + r[8] * dz,
    )


@inlined
def screen_rows(view: Any, x: Any, y: Any, z: Any) -> Any:
    """Return the rows t and u of J R_view: what moves u and v on the screen, six numbers."""
    r = view[at.R : at.R + 9]
    a = -min(max(x / z, view[at.X_LOW]), view[at.X_HIGH])
    b = -min(max(y / z, view[at.Y_LOW]), view[at.Y_HIGH])
    kx, ky = view[at.FX] / z, view[at.FY] / z
    return (
        kx * (r[0] + a * r[6]),
        kx * (r[1] + a * r[7]),
        kx * (r[2] + a * r[8]),
        ky * (r[3] + b * r[6]),
        ky * (r[4] + b * r[7]),
        ky * (r[5] + b * r[8]),
    )


@inlined
def own_axes(turn: Any, scales: Any, row: Any) -> Any:
    """Return M' row, three numbers; `turn` is a rotation, `scales` standard deviations."""
    return (
        scales[0] * (turn[0] * row[0] + turn[3] * row[1] + turn[6] * row[2]),
        scales[1] * (turn[1] * row[0] + turn[4] * row[1] + turn[7] * row[2]),
        scales[2] * (turn[2] * row[0] + turn[5] * row[1] + turn[8] * row[2]),
    )


@inlined
def log2_opacity(logit: Any) -> Any:
    """Return log2 of 1 / (1 + exp(-logit)) without overflow."""
    return -(math.log1p(math.exp(-abs(logit))) + max(-logit, 0.0)) / LN2


@kernel
def project(
    gaussians: Any,
    count: Any,
    view: Any,
    options: Any,
    first: Any,
    end: Any,
    records: Any,
    depths: Any,
) -> None:
    """Write the records of the Gaussians first..end-1, each at its own number.

    Args:
        gaussians: means (N, 3), log_scales (N, 3), quats (N, 4), opacity_logits (N,) and sh
            (N, K, 3), all float32.
        count: harmonics per channel that are in use: 1, 4, 9 or 16, at most K.
        view: (SIZE,) float64, view.py's vector of the whole image.
        options: (eps2d, antialiased, least square of the compensation).
        first: first Gaussian.
        end: behind the last one.
        records: (N * RECORD,) float32, out.
        depths: (N,) float32, out: z, infinite for those that the image does not show.
    """
    means, log_scales, quats, logits, sh = gaussians
    eps2d, antialiased, floor2 = options
    values = np.empty(16)
    scales = np.empty(3)
    for i in range(first, end):
        depths[i] = np.inf
        x, y, z = camera_point(view, means[i])
        if not (z >= view[at.NEAR] and z <= view[at.FAR]):
            continue
        lo = log2_opacity(float(logits[i]))
        if lo < THRESHOLD:
            continue
        turn = rotation(quats[i])
        for k in range(3):
            scales[k] = math.exp(float(log_scales[i, k]))
        rows = screen_rows(view, x, y, z)
        p = own_axes(turn, scales, rows[:3])
        q = own_axes(turn, scales, rows[3:])
        xx = p[0] * p[0] + p[1] * p[1] + p[2] * p[2]
        xy = p[0] * q[0] + p[1] * q[1] + p[2] * q[2]
        yy = q[0] * q[0] + q[1] * q[1] + q[2] * q[2]
        before = xx * yy - xy * xy
        xx, yy = xx + eps2d, yy + eps2d
        after = xx * yy - xy * xy
        if antialiased:
            lo += 0.5 * math.log2(max(before / after, floor2, LEAST_KEPT))
        reach = 2.0 * LN2 * (lo - THRESHOLD)
        if not (reach >= 0.0 and after > 0.0):
            continue
        u = view[at.FX] * x / z + view[at.CX]
        v = view[at.FY] * y / z + view[at.CY]
        rx = math.sqrt(reach * xx) * _WIDEN + _WIDEN_PIXELS
        ry = math.sqrt(reach * yy) * _WIDEN + _WIDEN_PIXELS
        x0 = max(math.ceil(u - rx - 0.5), 0.0)
        x1 = min(math.floor(u + rx - 0.5), view[at.COLUMN1] - 1.0)
        y0 = max(math.ceil(v - ry - 0.5), 0.0)
        y1 = min(math.floor(v + ry - 0.5), view[at.ROW1] - 1.0)
        if not (x0 <= x1 and y0 <= y1):
            continue
        depths[i] = z
        j = i * RECORD
        half = HALF_LOG2E / after
        poke(records, j + U, np.float32(u))
        poke(records, j + V, np.float32(v))
        poke(records, j + A, np.float32(yy * half))
        poke(records, j + B, np.float32(-2.0 * xy * half))
        poke(records, j + C, np.float32(xx * half))
        poke(records, j + LOG_OPACITY, np.float32(lo))
        poke(records, j + COLUMNS, float_of(int(x0) | (int(x1) << 16)))
        poke(records, j + ROWS, float_of(int(y0) | (int(y1) << 16)))
        poke(records, j + INVERSE_DEPTH, np.float32(1.0 / z))
        dx = float(means[i, 0]) - view[at.EYE]
        dy = float(means[i, 1]) - view[at.EYE + 1]
        dz = float(means[i, 2]) - view[at.EYE + 2]
        unit = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
        basis(dx * unit, dy * unit, dz * unit, count, values)
        for channel in range(3):
            colour = 0.5
            for k in range(count):
                colour += values[k] * sh[i, k, channel]
            poke(records, j + RED + channel, np.float32(max(colour, 0.0)))
