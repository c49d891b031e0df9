"""From gradients of records to gradients of Gaussians: project.py, line by line, backwards.

What project.py decides by comparison (who is shown, which bound of the Jacobian holds, which colour
is cut at 0) is decided in the same way here, and has no gradient.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nw_base.machine_code import inlined
from nw_splat.kernels import view as at
from nw_twin.gaussians.kernels import kernel
from nw_twin.gaussians.kernels.blend import (
    G_A,
    G_B,
    G_BEND,
    G_C,
    G_INVERSE,
    G_OPACITY,
    G_RED,
    G_SLOPE_X,
    G_SLOPE_Y,
    G_U,
    G_V,
)
from nw_twin.gaussians.kernels.project import (
    HALF_LOG2E,
    LEAST_KEPT,
    LN2,
    ahead_row,
    basis,
    bending,
    camera_point,
    dot,
    own_axes,
    rotation,
    rotation_back,
    screen_rows,
    slope,
)


@inlined
def _footprint_back(g: Any, p: Any, q: Any, options: Any) -> Any:
    eps2d, antialiased, floor2, _ = options
    xx0, xy, yy0 = dot(p, p), dot(p, q), dot(q, q)
    xx, yy = xx0 + eps2d, yy0 + eps2d
    after = xx * yy - xy * xy
    half = HALF_LOG2E / after
    # A = half yy, B = -2 half xy, C = half xx; half moves with 1 / after.
    g_after = -(g[G_A] * yy - 2.0 * g[G_B] * xy + g[G_C] * xx) * half / after
    g_xx, g_xy, g_yy = g[G_C] * half, -2.0 * g[G_B] * half, g[G_A] * half
    if antialiased:
        before = xx0 * yy0 - xy * xy
        if before / after > max(floor2, LEAST_KEPT):
            opacity = 0.5 * g[G_OPACITY] / LN2
            g_before = opacity / before
            g_after -= opacity / after
            g_xx += g_before * yy0
            g_yy += g_before * xx0
            g_xy -= 2.0 * g_before * xy
    return g_xx + g_after * yy, g_xy - 2.0 * g_after * xy, g_yy + g_after * xx


@inlined
def _ray_back(g: Any, p: Any, q: Any, w: Any, eps2d: Any) -> Any:
    """Return the gradient with respect to xx, xy, yy, xz, yz, zz by way of a, b and k.

    With S the footprint and c = (xz, yz): (a, b) = -inv(S) c moves by -inv(S) (dS (a, b) + dc).
    """
    xx, xy, yy = dot(p, p) + eps2d, dot(p, q), dot(q, q) + eps2d
    xz, yz = dot(p, w), dot(q, w)
    a, b, k = bending(xx, xy, yy, xz, yz, dot(w, w))
    g_k = 2.0 * LN2 * g[G_BEND] if k > 0.0 else 0.0
    g_a, g_b = g[G_SLOPE_X] + g_k * xz, g[G_SLOPE_Y] + g_k * yz
    after = xx * yy - xy * xy
    h_x, h_y = (yy * g_a - xy * g_b) / after, (xx * g_b - xy * g_a) / after
    return -h_x * a, -h_x * b - h_y * a, -h_y * b, g_k * a - h_x, g_k * b - h_y, g_k


@inlined
def _colour_back(g: Any, sh: Any, i: Any, count: Any, unit: Any, values: Any, out: Any) -> Any:
    """Write the gradient of a Gaussian's harmonics; return that of its direction.

    `values` is room for twice sixteen numbers.
    """
    basis(unit[0], unit[1], unit[2], count, values)
    values[16:] = 0.0
    for channel in range(3):
        colour = 0.5
        for k in range(count):
            colour += values[k] * sh[i, k, channel]
        if colour <= 0.0:
            continue
        along = float(g[G_RED + channel])
        for k in range(count):
            out[i, k, channel] = along * values[k]
            values[16 + k] += along * sh[i, k, channel]
    if count == 1:
        return 0.0, 0.0, 0.0
    return slope(unit[0], unit[1], unit[2], count, values[16:])


@inlined
def _mixed(a: Any, p: Any, b: Any, q: Any, c: Any, w: Any) -> Any:
    return (
        a * p[0] + b * q[0] + c * w[0],
        a * p[1] + b * q[1] + c * w[1],
        a * p[2] + b * q[2] + c * w[2],
    )


@inlined
def _scaled(scales: Any, g: Any) -> Any:
    return scales[0] * g[0], scales[1] * g[1], scales[2] * g[2]


@inlined
def _rows_back(g: Any, view: Any, point: Any, rows: Any, g_t: Any, g_u: Any) -> Any:
    x, y, z = point
    r = view[at.R : at.R + 9]
    fx, fy = view[at.FX], view[at.FY]
    gx, gy = g[G_U] * fx / z, g[G_V] * fy / z
    gz = -(gx * x + gy * y) / z - g[G_INVERSE] / (z * z)
    # t = fx / z (r0 + a r2), a = -x / z within bounds; the same for u.
    gz -= (dot(g_t, rows[:3]) + dot(g_u, rows[3:])) / z
    if view[at.X_LOW] < x / z < view[at.X_HIGH]:
        g_a = fx / z * dot(g_t, r[6:9])
        gx -= g_a / z
        gz += g_a * x / (z * z)
    if view[at.Y_LOW] < y / z < view[at.Y_HIGH]:
        g_b = fy / z * dot(g_u, r[6:9])
        gy -= g_b / z
        gz += g_b * y / (z * z)
    return gx, gy, gz


@kernel
def project_back(
    gaussians: Any,
    count: Any,
    view: Any,
    options: Any,
    first: Any,
    end: Any,
    depths: Any,
    screen: Any,
    out: Any,
) -> None:
    """Write the gradients of the Gaussians first..end-1; zero for those that are not shown.

    Args:
        gaussians: as `project` takes them.
        count: harmonics per channel that are in use.
        view: (SIZE,) float64.
        options: as `project` takes them.
        first: first Gaussian.
        end: behind the last one.
        depths: (N,) float32 of `project`.
        screen: (N, GRADIENT) float32, gradients with respect to records.
        out: arrays shaped like those of `gaussians`.
    """
    means, log_scales, quats, logits, sh = gaussians
    g_means, g_scales, g_quats, g_logits, g_sh = out
    values = np.empty(32)
    scales = np.empty(3)
    r = view[at.R : at.R + 9]
    for i in range(first, end):
        g_means[i], g_scales[i], g_quats[i] = 0.0, 0.0, 0.0
        g_logits[i] = 0.0
        g_sh[i] = 0.0
        if not np.isfinite(depths[i]):
            continue
        g = screen[i]
        x, y, z = camera_point(view, means[i])
        turn = rotation(quats[i])
        for k in range(3):
            scales[k] = math.exp(float(log_scales[i, k]))
        rows = screen_rows(view, x, y, z)
        t, u = rows[:3], rows[3:]
        p, q = own_axes(turn, scales, t), own_axes(turn, scales, u)
        g_xx, g_xy, g_yy = _footprint_back(g, p, q, options)
        g_xz = g_yz = g_zz = 0.0
        ahead = w = (0.0, 0.0, 0.0)
        if options[3] is not None:
            ahead = ahead_row(view, z)
            w = own_axes(turn, scales, ahead)
            more_xx, more_xy, more_yy, g_xz, g_yz, g_zz = _ray_back(g, p, q, w, options[0])
            g_xx, g_xy, g_yy = g_xx + more_xx, g_xy + more_xy, g_yy + more_yy
        # log2 of the logistic function has slope (1 - opacity) / ln 2.
        g_logits[i] = g[G_OPACITY] / LN2 / (1.0 + math.exp(float(logits[i])))
        g_p = _mixed(2.0 * g_xx, p, g_xy, q, g_xz, w)
        g_q = _mixed(2.0 * g_yy, q, g_xy, p, g_yz, w)
        g_w = _mixed(2.0 * g_zz, w, g_xz, p, g_yz, q)
        for k in range(3):
            g_scales[i, k] = g_p[k] * p[k] + g_q[k] * q[k] + g_w[k] * w[k]
        # p = S R' t: what moves p moves scales, turn and t, one axis at a time.
        a, b, c = _scaled(scales, g_p), _scaled(scales, g_q), _scaled(scales, g_w)
        g_turn = (
            a[0] * t[0] + b[0] * u[0] + c[0] * ahead[0],
            a[1] * t[0] + b[1] * u[0] + c[1] * ahead[0],
            a[2] * t[0] + b[2] * u[0] + c[2] * ahead[0],
            a[0] * t[1] + b[0] * u[1] + c[0] * ahead[1],
            a[1] * t[1] + b[1] * u[1] + c[1] * ahead[1],
            a[2] * t[1] + b[2] * u[1] + c[2] * ahead[1],
            a[0] * t[2] + b[0] * u[2] + c[0] * ahead[2],
            a[1] * t[2] + b[1] * u[2] + c[1] * ahead[2],
            a[2] * t[2] + b[2] * u[2] + c[2] * ahead[2],
        )
        rotation_back(quats[i], g_turn, g_quats[i])
        g_t = dot(turn[0:3], a), dot(turn[3:6], a), dot(turn[6:9], a)
        g_u = dot(turn[0:3], b), dot(turn[3:6], b), dot(turn[6:9], b)
        g_ahead = dot(turn[0:3], c), dot(turn[3:6], c), dot(turn[6:9], c)
        gx, gy, gz = _rows_back(g, view, (x, y, z), rows, g_t, g_u)
        gz -= dot(g_ahead, ahead) / z
        # The direction of the harmonics moves with the mean too, across itself.
        dx = float(means[i, 0]) - view[at.EYE]
        dy = float(means[i, 1]) - view[at.EYE + 1]
        dz = float(means[i, 2]) - view[at.EYE + 2]
        inverse = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
        unit = (dx * inverse, dy * inverse, dz * inverse)
        d = _colour_back(g, sh, i, count, unit, values, g_sh)
        along = dot(d, unit)
        for k in range(3):
            across = (d[k] - unit[k] * along) * inverse
            g_means[i, k] = r[k] * gx + r[3 + k] * gy + r[6 + k] * gz + across
