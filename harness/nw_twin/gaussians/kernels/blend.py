"""The blend of one window: which records touch it, and its gradient, front to back.

The records that touch the window are gathered, nearest first, in one stream.

For a pixel with transmittance T before splat i, weight w_i = T alpha_i, and upstream gradients g:
with s_i = g_r r_i + g_g g_i + g_b b_i + g_d / z_i and T_n the light that reaches the background,

    dL / dalpha_i = T s_i - R_i / (1 - alpha_i),
    R_i = sum_{j > i} w_j s_j + T_n (g . background - g_alpha).

R before the first splat is known from the finished picture: g . picture, less g_alpha T_n. What a
splat adds is taken from it as the splats are walked in the order in which they were blended. So
nothing needs to be kept from the forward pass, and the arithmetic that decides which splat finishes
a pixel is the renderer's own, bit for bit.

Along the ray, log2 alpha = log_opacity - e / D with D = k e + m^2 (see the renderer's project.py),
and its partials are -m^2 / D^2 by e, e^2 / D^2 by k, and 2 e m / D^2 by m, which moves with the
centre and with (a, b). With m^2 / D^2 = 1 and no k and m, that is EWA.

Planes are six rows of floats for each row of pixels: T, R, and the gradients of red, green, blue
and inverse depth. A finished pixel holds -T, pixels outside the window -1. As in the renderer, each
splat is walked with the shape of vector that fits it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types

from nw_base.machine_code import inlined
from nw_base.simd.lanes import (
    I32,
    broadcast,
    fma,
    intrinsic,
    lane_list,
    mask_bits,
    maximum,
    minimum,
    minus_abs,
    negate,
    where,
)
from nw_base.simd.memory import load, peek, poke, store
from nw_splat.kernels.blend import (
    CHANNELS,
    FLAT,
    LINE,
    SLACK_COLUMNS,
    SLACK_ROWS,
    SQUARE,
    LaneShape,
    columns_part,
    row_spans,
)
from nw_splat.kernels.math8 import bits_of, exp2, float_of
from nw_splat.kernels.project import (
    BEND,
    BLUE,
    COLUMNS,
    GREEN,
    LOG_OPACITY,
    RECORD,
    RED,
    ROWS,
    SLOPE_X,
    SLOPE_Y,
    THRESHOLD,
    A,
    B,
    C,
    U,
    V,
)
from nw_twin.gaussians.kernels import kernel
from nw_twin.gaussians.kernels.project import INVERSE_DEPTH, LN2

PLANES = 6
"""Rows of floats for each row of pixels."""

# Places in a row of gradients: with respect to colour, inverse depth, log2 opacity, centre, conic,
# and what the ray form adds.
G_RED, G_INVERSE, G_OPACITY, G_U, G_V, G_A, G_B, G_C = 0, 3, 4, 5, 6, 7, 8, 9
G_SLOPE_X, G_SLOPE_Y, G_BEND = 10, 11, 12
GRADIENT = 13
"""Floats in a row of gradients."""
_square_columns, _square_rows = SQUARE.columns, SQUARE.rows
_flat_columns, _flat_rows = FLAT.columns, FLAT.rows
_line_columns = LINE.columns


@kernel
def gather(
    records: Any, ordered: Any, count: Any, column0: Any, column1: Any, out: Any, owners: Any
) -> Any:
    """Copy the records that touch columns column0..column1-1; their columns then count from there.

    Args:
        records: float32, of the whole image.
        ordered: int64 keys, nearest first; record numbers in the lower halves.
        count: how many.
        column0: first column of the window.
        column1: behind its last one.
        out: float32, room for `count` records.
        owners: (count,) int64, out: record numbers.

    Returns:
        How many touch the window.
    """
    copied = 0
    for i in range(count):
        number = peek(ordered, i) & 0xFFFFFFFF
        j = number * RECORD
        packed = int(bits_of(peek(records, j + COLUMNS)))
        first, last = packed & 0xFFFF, packed >> 16
        if first >= column1 or last < column0:
            continue
        first, last = max(first, column0) - column0, min(last, column1 - 1) - column0
        o = copied * RECORD
        lower, upper = load(records, j), load(records, j + 8)
        store(out, o, lower)
        store(out, o + 8, upper)
        poke(out, o + COLUMNS, float_of(first | (last << 16)))
        poke(owners, copied, number)
        copied += 1
    return copied


@kernel
def scatter(gradients: Any, owners: Any, count: Any, out: Any, width: Any) -> None:
    """Add each row of a window's gradients to the row of the Gaussian that it belongs to.

    Args:
        gradients: (count * width,) float32.
        owners: (count,) int64.
        count: rows.
        out: (N * width,) float32, added to.
        width: numbers in a row.
    """
    for i in range(count):
        source, target = i * width, peek(owners, i) * width
        for k in range(width):
            poke(out, target + k, peek(out, target + k) + peek(gradients, source + k))


@inlined
def _power(ray: Any, dy: Any, of_columns: Any, splat: Any) -> Any:
    """Return log2 of alpha, to the bit as the renderer has it, and what its partials need."""
    across, slope, lean = of_columns
    c, log_opacity, slope_y, bend = splat
    if ray is None:
        return fma(negate(fma(dy, c, slope)), dy, across), None
    e = fma(fma(dy, c, slope), dy, across)
    m = maximum(fma(dy, slope_y, lean), 0.0)
    whole = fma(e, bend, m * m)
    return log_opacity - e / whole, (e, m, whole)


def _stepping(shape: LaneShape) -> Any:
    load, store = shape.load, shape.store

    @inlined
    def step(
        ray: Any, planes: Any, o: Any, stride: Any, d: Any, exponent: Any, splat: Any, sums: Any
    ) -> Any:
        """Walk sixteen pixels, the first at o: take the splat from R and T, add to the sums."""
        threshold, finished, most_alpha, numbers, red, green, blue, inverse = splat
        dx, dy = d
        power, of_ray = exponent
        step = PLANES * stride
        T = load(planes, o, step)
        live = (power >= threshold) & (T > 0.0)
        if mask_bits(live) == 0:
            return sums
        full = exp2(minimum(power, 0.0), numbers)
        alpha = minimum(full, most_alpha)
        weight = where(live, alpha * T, 0.0)
        left = T - weight
        finish = left <= finished
        store(planes, o, step, where(finish, minus_abs(T), left))
        weight = where(finish, 0.0, weight)
        gr, gg = load(planes, o + 2 * stride, step), load(planes, o + 3 * stride, step)
        gb, gd = load(planes, o + 4 * stride, step), load(planes, o + 5 * stride, step)
        shade = fma(gr, red, fma(gg, green, fma(gb, blue, gd * inverse)))
        rest = fma(negate(weight), shade, load(planes, o + stride, step))
        store(planes, o + stride, step, rest)
        # weight is 0 where nothing was blended; a clamped alpha does not move.
        moved = where(full < most_alpha, weight, 0.0)
        slope = moved * (shade - rest / (T - alpha * T))
        (sr, sg, sb, sd, s0, sx, sy, sxx, sxy, syy), of_m = sums
        s0 = s0 + slope
        if ray is not None:
            e, m, whole = of_ray
            sm, smx, smy, sk = of_m
            # Where nothing is blended, the whole may be 0.
            scaled = where(live, slope / (whole * whole), 0.0)
            along = scaled * (e * m)
            of_m = sm + along, fma(along, dx, smx), fma(along, dy, smy), fma(scaled * e, e, sk)
            slope = scaled * (m * m)
        tx, ty = slope * dx, slope * dy
        return (
            fma(weight, gr, sr),
            fma(weight, gg, sg),
            fma(weight, gb, sb),
            fma(weight, gd, sd),
            s0,
            sx + tx,
            sy + ty,
            fma(tx, dx, sxx),
            fma(tx, dy, sxy),
            fma(ty, dy, syy),
        ), of_m

    return step


_step_square, _step_flat, _step_line = _stepping(SQUARE), _stepping(FLAT), _stepping(LINE)


@kernel
def lay_planes(planes: Any, stride: Any, window: Any, gradients: Any, pictures: Any) -> None:
    """Prepare the planes of a window.

    Args:
        planes: float32, out.
        stride: pixels in a row, slack included.
        window: (column0, column1, height).
        gradients: (rgb (3, H, W), alpha (H, W), inverse depth (H, W)) float32, upstream.
        pictures: as above, as rendered.
    """
    column0, column1, height = window
    g_rgb, g_alpha, g_inverse = gradients
    rgb, alpha, inverse = pictures
    width = column1 - column0
    for y in range(height + SLACK_ROWS):
        row = y * PLANES * stride
        for x in range(stride):
            planes[row + x] = np.float32(-1)
        planes[row + stride : row + PLANES * stride] = np.float32(0)
        if y >= height:
            continue
        for x in range(width):
            c = column0 + x
            planes[row + x] = np.float32(1)
            light = np.float32(1) - alpha[y, c]
            rest = g_inverse[y, c] * inverse[y, c] - g_alpha[y, c] * light
            for k in range(3):
                rest += g_rgb[k, y, c] * rgb[k, y, c]
                planes[row + (2 + k) * stride + x] = g_rgb[k, y, c]
            planes[row + stride + x] = rest
            planes[row + 5 * stride + x] = g_inverse[y, c]


@kernel
def blend_back(
    records: Any,
    count: Any,
    centres: Any,
    view: Any,
    planes: Any,
    stride: Any,
    most_alpha: Any,
    ray: Any,
    numbers: Any,
    out: Any,
) -> None:
    """Write the gradient with respect to each record of a window.

    Args:
        records: float32, nearest first.
        count: how many.
        centres: (columns, rows) float32 pixel centres of the window, with slack.
        view: (SIZE,) float32 of the window, as it was blended with.
        planes: float32 of `lay_planes`; used up.
        stride: pixels in a row, slack included.
        most_alpha: alpha is clamped to it.
        ray: None for EWA, anything else along the ray, as it was blended.
        numbers: the renderer's CURVE.
        out: (count * GRADIENT,) float32, out.
    """
    columns, rows = centres
    row_step = PLANES * stride
    spans = np.empty(8, np.float32)
    span_bits = spans.view(np.int32)
    curve = (
        broadcast(numbers[0]),
        broadcast(numbers[1]),
        broadcast(most_alpha),
        (
            broadcast(numbers[2]),
            broadcast(numbers[3]),
            broadcast(numbers[4]),
            broadcast(numbers[5]),
            broadcast(numbers[6]),
            broadcast(numbers[7]),
            broadcast(numbers[8]),
        ),
    )
    zero = broadcast(np.float32(0.0))
    for i in range(count):
        j = i * RECORD
        packed_x = int(bits_of(peek(records, j + COLUMNS)))
        packed_y = int(bits_of(peek(records, j + ROWS)))
        xa, xb = packed_x & 0xFFFF, packed_x >> 16
        ya, yb = packed_y & 0xFFFF, packed_y >> 16
        u, v = broadcast(peek(records, j + U)), broadcast(peek(records, j + V))
        ca, cb = broadcast(peek(records, j + A)), broadcast(peek(records, j + B))
        log_opacity = broadcast(peek(records, j + LOG_OPACITY))
        slope_x = log_opacity if ray is None else broadcast(peek(records, j + SLOPE_X))
        form = (
            broadcast(peek(records, j + C)),
            log_opacity,
            log_opacity if ray is None else broadcast(peek(records, j + SLOPE_Y)),
            log_opacity if ray is None else broadcast(peek(records, j + BEND)),
        )
        splat = (
            curve[0],
            curve[1],
            curve[2],
            curve[3],
            broadcast(peek(records, j + RED)),
            broadcast(peek(records, j + GREEN)),
            broadcast(peek(records, j + BLUE)),
            broadcast(peek(records, j + INVERSE_DEPTH)),
        )
        sums = (
            (zero, zero, zero, zero, zero, zero, zero, zero, zero, zero),
            None if ray is None else (zero, zero, zero, zero),
        )
        if xb - xa < 4:
            dx = _square_columns(columns, xa) - u
            of_columns = columns_part(ray, dx, ca, cb, log_opacity, slope_x)
            for y in range(ya, yb + 1, 4):
                dy = _square_rows(rows, y) - v
                power = _power(ray, dy, of_columns, form)
                sums = _step_square(
                    ray, planes, y * row_step + xa, stride, (dx, dy), power, splat, sums
                )
        elif xb - xa < 8:
            dx = _flat_columns(columns, xa) - u
            of_columns = columns_part(ray, dx, ca, cb, log_opacity, slope_x)
            for y in range(ya, yb + 1, 2):
                dy = _flat_rows(rows, y) - v
                power = _power(ray, dy, of_columns, form)
                sums = _step_flat(
                    ray, planes, y * row_step + xa, stride, (dx, dy), power, splat, sums
                )
        else:
            outline = (
                peek(records, j + U),
                peek(records, j + A),
                peek(records, j + B),
                peek(records, j + C),
                peek(records, j + LOG_OPACITY) - THRESHOLD,
                peek(records, j + SLOPE_X),
                peek(records, j + SLOPE_Y),
                peek(records, j + BEND),
            )
            for y in range(ya, yb + 1):
                dy = broadcast(peek(rows, y)) - v
                low, high = xa, xb
                if xb - xa >= 16:
                    if (y - ya) & 7 == 0:
                        below = load(rows, y) - peek(records, j + V)
                        store(spans, 0, row_spans(ray, below, outline, view, xa, xb))
                    packed = int(peek(span_bits, (y - ya) & 7))
                    low, high = packed & 0xFFFF, packed >> 16
                for x in range(low, high + 1, 16):
                    dx = _line_columns(columns, x) - u
                    of_columns = columns_part(ray, dx, ca, cb, log_opacity, slope_x)
                    power = _power(ray, dy, of_columns, form)
                    sums = _step_line(
                        ray, planes, y * row_step + x, stride, (dx, dy), power, splat, sums
                    )
        _write(ray, out, i * GRADIENT, records, j, sums)


@inlined
def _write(ray: Any, out: Any, g: Any, records: Any, j: Any, sums: Any) -> None:
    """Write a row: alpha = 2^(log_opacity - e / D), e = A dx^2 + B dx dy + C dy^2; EWA: D = 1."""
    ln2 = np.float32(LN2)
    (sr, sg, sb, sd, s0, sx, sy, sxx, sxy, syy), of_m = sums
    poke(out, g + G_RED, total(sr))
    poke(out, g + G_RED + 1, total(sg))
    poke(out, g + G_RED + 2, total(sb))
    poke(out, g + G_INVERSE, total(sd))
    poke(out, g + G_OPACITY, ln2 * total(s0))
    across, down = ln2 * total(sx), ln2 * total(sy)
    a, b, c = peek(records, j + A), peek(records, j + B), peek(records, j + C)
    g_u = np.float32(2) * a * across + b * down
    g_v = np.float32(2) * c * down + b * across
    if ray is None:
        poke(out, g + G_SLOPE_X, np.float32(0))
        poke(out, g + G_SLOPE_Y, np.float32(0))
        poke(out, g + G_BEND, np.float32(0))
    else:
        sm, smx, smy, sk = of_m
        twice = np.float32(2) * ln2
        g_m = twice * total(sm)
        g_u -= peek(records, j + SLOPE_X) * g_m
        g_v -= peek(records, j + SLOPE_Y) * g_m
        poke(out, g + G_SLOPE_X, twice * total(smx))
        poke(out, g + G_SLOPE_Y, twice * total(smy))
        poke(out, g + G_BEND, ln2 * total(sk))
    poke(out, g + G_U, g_u)
    poke(out, g + G_V, g_v)
    poke(out, g + G_A, -ln2 * total(sxx))
    poke(out, g + G_B, -ln2 * total(sxy))
    poke(out, g + G_C, -ln2 * total(syy))


@kernel
def resolve(light: Any, paint: Any, window: Any, background: Any, pictures: Any) -> None:
    """Write a blended window into the pictures, which are planes here.

    Args:
        light: float32, the renderer's.
        paint: float32, the renderer's.
        window: (column0, column1, height).
        background: (3,) float32.
        pictures: (rgb (3, H, W), alpha (H, W), inverse depth (H, W)) float32, out.
    """
    rgb, alpha, inverse = pictures
    column0, column1, height = window
    stride = column1 - column0 + SLACK_COLUMNS
    for y in range(height):
        for x in range(column1 - column0):
            o = y * stride + x
            T = abs(peek(light, o))
            for k in range(3):
                value = peek(paint, CHANNELS * o + k) + T * background[k]
                rgb[k, y, column0 + x] = value
            alpha[y, column0 + x] = np.float32(1) - T
            inverse[y, column0 + x] = peek(paint, CHANNELS * o + 3)


@intrinsic
def total(_typing: Any, x: Any) -> Any:
    """Return the sum of the lanes: halves are added until one is left, always in this order."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        value, lanes = args[0], x.lanes
        while lanes > 1:
            lanes //= 2
            undefined = ir.Constant(value.type, ir.Undefined)
            low = builder.shuffle_vector(value, undefined, lane_list(list(range(lanes))))
            high = builder.shuffle_vector(
                value, undefined, lane_list(list(range(lanes, 2 * lanes)))
            )
            value = builder.fadd(low, high)
        return builder.extract_element(value, ir.Constant(I32, 0))

    return types.float32(x), generate
