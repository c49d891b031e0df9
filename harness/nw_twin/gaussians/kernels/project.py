"""From Gaussians to the renderer's records, in double precision, one by one.

The formulas are those of the renderer's project.py (which see), with one difference: place 11 of a
record, which the blend treats as a fourth colour, holds 1 / z, so that the fourth picture is the
expected inverse depth sum_i w_i / z_i, which training compares with depth maps.

With M = R diag(s) and the rows t, u of J R_view, the footprint's covariance t' M M' t etc. is taken
as products of p = M' t and q = M' u: no covariance is formed, and none can lose its rank. Along the
ray, xz, yz and zz are products with M' w, w = r2 / z, as above; the rows have no bounds then.

Rotations are from quaternions w x y z of any length. Real spherical harmonics are in the order and
with the signs of the renderer's harmonics.py. The polynomials are taken as they stand, off the unit
sphere too: whoever uses the slopes leaves out what points along the direction.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nw_base.machine_code import inlined
from nw_base.simd.memory import poke
from nw_splat.kernels import view as at
from nw_splat.kernels.math8 import float_of
from nw_splat.kernels.project import (
    BEND,
    COLUMNS,
    DEPTH,
    LOG_OPACITY,
    RECORD,
    RED,
    ROWS,
    SLOPE_X,
    SLOPE_Y,
    STEEPEST,
    THRESHOLD,
    A,
    B,
    C,
    U,
    V,
)
from nw_twin.gaussians.kernels import kernel

INVERSE_DEPTH = DEPTH
"""Where a record of training has 1 / z."""

HALF_LOG2E = 0.5 * math.log2(math.e)
LN2 = math.log(2.0)
LEAST_KEPT = 1e-30
"""Least square of the antialiasing factor, as in the renderer."""

_WIDEN, _WIDEN_PIXELS = 1.00002, 0.002
_RAY_WIDEN, _RAY_WIDEN_PIXELS = 1.0001, 0.01
_UNBOUNDED = 1e9

C0 = 0.28209479177387814
_C1 = 0.4886025119029199
_XY, _ZZ, _XX_YY = 1.0925484305920792, 0.31539156525252005, 0.5462742152960396
_C33, _C32, _C31, _C30 = (
    0.5900435899266435,
    2.890611442640554,
    0.4570457994644658,
    0.3731763325901154,
)
_C3Z = 1.445305721320277


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
def ahead_row(view: Any, z: Any) -> Any:
    """Return the row w: what moves the depth, as a share of it, three numbers."""
    return view[at.R + 6] / z, view[at.R + 7] / z, view[at.R + 8] / z


@inlined
def own_axes(turn: Any, scales: Any, row: Any) -> Any:
    """Return M' row, three numbers; `turn` is a rotation, `scales` standard deviations."""
    return (
        scales[0] * (turn[0] * row[0] + turn[3] * row[1] + turn[6] * row[2]),
        scales[1] * (turn[1] * row[0] + turn[4] * row[1] + turn[7] * row[2]),
        scales[2] * (turn[2] * row[0] + turn[5] * row[1] + turn[8] * row[2]),
    )


@inlined
def dot(p: Any, q: Any) -> Any:
    """Return the product of three numbers with three."""
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]


@inlined
def bending(xx: Any, xy: Any, yy: Any, xz: Any, yz: Any, zz: Any) -> Any:
    """Return a, b and k of the ray form; the footprint includes the blur."""
    after = xx * yy - xy * xy
    a, b = (xy * yz - yy * xz) / after, (xy * xz - xx * yz) / after
    return a, b, zz + a * xz + b * yz


@inlined
def _ray_side(reach: Any, variance: Any, lean: Any, depth: Any) -> Any:
    """Return how far a Gaussian reaches before and behind its centre along a side of the image."""
    along, span = reach * lean, reach * variance
    root = math.sqrt(max(reach * (variance * (1.0 - reach * depth) + lean * along), 0.0))
    before = behind = _UNBOUNDED
    # Where rounding might decide whether there is a bound, there is none.
    if root > 1e-5 * span:
        least = 1e-3 * root
        if root - along > least:
            before = span / (root - along)
        if root + along > least:
            behind = span / (root + along)
    return before + _RAY_WIDEN_PIXELS, behind + _RAY_WIDEN_PIXELS


@inlined
def log2_opacity(logit: Any) -> Any:
    """Return log2 of 1 / (1 + exp(-logit)) without overflow."""
    return -(math.log1p(math.exp(-abs(logit))) + max(-logit, 0.0)) / LN2


@kernel
def project(  # noqa: C901 - two projections in one loop.
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
        options: (eps2d, antialiased, least square of the compensation, None for EWA or anything
            else along the ray).
        first: first Gaussian.
        end: behind the last one.
        records: (N * RECORD,) float32, out.
        depths: (N,) float32, out: z, infinite for those that the image does not show.
    """
    means, log_scales, quats, logits, sh = gaussians
    eps2d, antialiased, floor2, ray = options
    values = np.empty(16)
    scales = np.empty(3)
    for i in range(first, end):
        depths[i] = np.inf
        x, y, z = camera_point(view, means[i])
        if not (z >= view[at.NEAR] and z <= view[at.FAR]):
            continue
        if ray is not None and not x * x + y * y < STEEPEST * z * z:
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
        xx, xy, yy = dot(p, p), dot(p, q), dot(q, q)
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
        if ray is None:
            to_left = to_right = math.sqrt(reach * xx) * _WIDEN + _WIDEN_PIXELS
            above = below = math.sqrt(reach * yy) * _WIDEN + _WIDEN_PIXELS
        else:
            w = own_axes(turn, scales, ahead_row(view, z))
            xz, yz, zz = dot(p, w), dot(q, w), dot(w, w)
            wide = reach * _RAY_WIDEN + 1e-6
            to_left, to_right = _ray_side(wide, xx, xz, zz)
            above, below = _ray_side(wide, yy, yz, zz)
            a, b, k = bending(xx, xy, yy, xz, yz, zz)
            j = i * RECORD
            poke(records, j + SLOPE_X, np.float32(a))
            poke(records, j + SLOPE_Y, np.float32(b))
            poke(records, j + BEND, np.float32(max(k, 0.0) * 2.0 * LN2))
        x0 = max(math.ceil(u - to_left - 0.5), 0.0)
        x1 = min(math.floor(u + to_right - 0.5), view[at.COLUMN1] - 1.0)
        y0 = max(math.ceil(v - above - 0.5), 0.0)
        y1 = min(math.floor(v + below - 0.5), view[at.ROW1] - 1.0)
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


@inlined
def rotation(quat: Any) -> Any:
    """Return the rotation of a quaternion row by row, nine numbers: own axes to world."""
    w, x, y, z = float(quat[0]), float(quat[1]), float(quat[2]), float(quat[3])
    k = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w * k, x * k, y * k, z * k
    return (
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y),
    )


@inlined
def rotation_back(quat: Any, g: Any, out: Any) -> None:
    """Write the gradient with respect to a quaternion; g is that to its rotation's nine numbers.

    The length of the quaternion does not matter to its rotation: the gradient is across it.
    """
    w, x, y, z = float(quat[0]), float(quat[1]), float(quat[2]), float(quat[3])
    k = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w * k, x * k, y * k, z * k
    gw = 2.0 * (x * (g[7] - g[5]) + y * (g[2] - g[6]) + z * (g[3] - g[1]))
    gx = 2.0 * (y * (g[1] + g[3]) + z * (g[2] + g[6]) + w * (g[7] - g[5]))
    gx -= 4.0 * x * (g[4] + g[8])
    gy = 2.0 * (x * (g[1] + g[3]) + z * (g[5] + g[7]) + w * (g[2] - g[6]))
    gy -= 4.0 * y * (g[0] + g[8])
    gz = 2.0 * (x * (g[2] + g[6]) + y * (g[5] + g[7]) + w * (g[3] - g[1]))
    gz -= 4.0 * z * (g[0] + g[4])
    along = w * gw + x * gx + y * gy + z * gz
    out[0], out[1] = (gw - w * along) * k, (gx - x * along) * k
    out[2], out[3] = (gy - y * along) * k, (gz - z * along) * k


@inlined
def basis(x: Any, y: Any, z: Any, count: Any, values: Any) -> None:
    """Write the first `count` (1, 4, 9 or 16) harmonics of a unit direction into `values`."""
    values[0] = C0
    if count > 1:
        values[1], values[2], values[3] = -_C1 * y, _C1 * z, -_C1 * x
    if count > 4:
        xx, yy, zz = x * x, y * y, z * z
        values[4], values[5], values[7] = _XY * x * y, -_XY * y * z, -_XY * x * z
        values[6] = _ZZ * (3.0 * zz - 1.0)
        values[8] = _XX_YY * (xx - yy)
        if count > 9:
            ring = 1.0 - 5.0 * zz
            values[9] = -_C33 * y * (3.0 * xx - yy)
            values[10] = _C32 * x * y * z
            values[11] = _C31 * y * ring
            values[12] = _C30 * z * (5.0 * zz - 3.0)
            values[13] = _C31 * x * ring
            values[14] = _C3Z * z * (xx - yy)
            values[15] = -_C33 * x * (xx - 3.0 * yy)


@inlined
def slope(x: Any, y: Any, z: Any, count: Any, g: Any) -> Any:
    """Return the gradient of sum_k g[k] Y_k with respect to (x, y, z); Y_0 has none."""
    gx, gy, gz = -_C1 * g[3], -_C1 * g[1], _C1 * g[2]
    if count > 4:
        gx += _XY * (g[4] * y - g[7] * z) + 2.0 * _XX_YY * g[8] * x
        gy += _XY * (g[4] * x - g[5] * z) - 2.0 * _XX_YY * g[8] * y
        gz += 6.0 * _ZZ * g[6] * z - _XY * (g[5] * y + g[7] * x)
        if count > 9:
            xx, yy, zz = x * x, y * y, z * z
            ring, rest = 1.0 - 5.0 * zz, 3.0 * (xx - yy)
            gx += -6.0 * _C33 * g[9] * x * y + _C32 * g[10] * y * z + _C31 * g[13] * ring
            gx += 2.0 * _C3Z * g[14] * x * z - _C33 * g[15] * rest
            gy += -_C33 * g[9] * rest + _C32 * g[10] * x * z + _C31 * g[11] * ring
            gy += -2.0 * _C3Z * g[14] * y * z + 6.0 * _C33 * g[15] * x * y
            gz += _C32 * g[10] * x * y - 10.0 * _C31 * z * (g[11] * y + g[13] * x)
            gz += _C30 * g[12] * (15.0 * zz - 3.0) + _C3Z * g[14] * (xx - yy)
    return gx, gy, gz
