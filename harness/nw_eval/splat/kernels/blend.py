"""Front-to-back compositing, splat by splat, into a framebuffer small enough for the cache.

For a pixel with transmittance T and a splat with alpha: when T (1 - alpha) <= 1e-4 the pixel is
finished and the splat is not added; otherwise colour += T alpha c, T -= T alpha. Splats with
alpha < 1/255 are skipped. This is gsplat's rule, in gsplat's order.

The framebuffer has five planes side by side in each row: T, red, green, blue, depth. A finished
pixel holds -T. Pixels outside the window hold -1. `live` counts the unfinished pixels of
each 8x8 block of the window, so that splats and chunks behind finished blocks are left out.

Each splat is drawn with the shape of vector that fits it: 4x2 pixels for splats up to four
pixels wide, 8x1 for up to eight, and row spans solved from its ellipse for the others. All three
evaluate the same expression in the same order, so a pixel's bits do not depend on the shape.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from nw_eval.machine_code.jit import inlined, kernel
from nw_eval.splat.kernels import view as at
from nw_eval.splat.kernels.bits import bits_of, lowest_bit, pack_range
from nw_eval.splat.kernels.math8 import exp2, taken_below
from nw_eval.splat.kernels.memory import load, load_rows, peek, poke, prefetch, store, store_rows
from nw_eval.splat.kernels.project import (
    BLUE,
    COLUMNS,
    DEPTH,
    GREEN,
    LOG_OPACITY,
    RED,
    ROWS,
    THRESHOLD,
    A,
    B,
    C,
    U,
    V,
)
from nw_eval.splat.kernels.records import RECORD
from nw_eval.splat.kernels.simd import (
    and_not,
    broadcast,
    ceil,
    floor,
    fma,
    halves,
    mask_bits,
    maximum,
    minimum,
    negate,
    sqrt,
    where,
)

FINISHED = 1e-4
"""Transmittance at which a pixel takes no more splats."""

PLANES = 5
AHEAD = 10
"""Splats by which records are fetched ahead of their use."""

SLACK_COLUMNS, SLACK_ROWS = 8, 4
"""Columns and rows behind the window that vectors may touch; their pixels count as finished."""


@inlined
def _alpha_step(power: Any, T: Any, most_alpha: Any) -> Any:
    """Return (weight, new T with the sign of finished, lanes that finish now)."""
    ok = (power >= THRESHOLD) & (T > 0.0)
    weight = minimum(exp2(maximum(power, -30.0)), most_alpha) * T
    left = T - weight
    finish = ok & (left <= FINISHED)
    weight = where(and_not(ok, finish), weight, 0.0)
    return weight, where(finish, negate(T), T - weight), finish


@inlined
def _draw8(frame: Any, o: Any, plane: Any, power: Any, most_alpha: Any, colour: Any) -> Any:
    """Blend 8x1 pixels; return the lanes that finished as bits."""
    weight, T, finish = _alpha_step(power, load(frame, o), most_alpha)
    store(frame, o, T)
    o += plane
    store(frame, o, fma(weight, colour[0], load(frame, o)))
    o += plane
    store(frame, o, fma(weight, colour[1], load(frame, o)))
    o += plane
    store(frame, o, fma(weight, colour[2], load(frame, o)))
    o += plane
    store(frame, o, fma(weight, colour[3], load(frame, o)))
    return mask_bits(finish)


@inlined
def _draw_rows(
    frame: Any, o: Any, p: Any, plane: Any, power: Any, most_alpha: Any, colour: Any
) -> Any:
    """Blend 4x2 pixels at o (upper) and p (lower); return the lanes that finished as bits."""
    weight, T, finish = _alpha_step(power, load_rows(frame, o, p), most_alpha)
    store_rows(frame, o, p, T)
    o += plane
    p += plane
    store_rows(frame, o, p, fma(weight, colour[0], load_rows(frame, o, p)))
    o += plane
    p += plane
    store_rows(frame, o, p, fma(weight, colour[1], load_rows(frame, o, p)))
    o += plane
    p += plane
    store_rows(frame, o, p, fma(weight, colour[2], load_rows(frame, o, p)))
    o += plane
    p += plane
    store_rows(frame, o, p, fma(weight, colour[3], load_rows(frame, o, p)))
    return mask_bits(finish)


@inlined
def _retire(live: Any, live_stride: Any, x: Any, y: Any) -> Any:
    place = (y >> 3) * live_stride + (x >> 3)
    poke(live, place, peek(live, place) - 1)


@inlined
def _any_live(live: Any, live_stride: Any, x0: Any, x1: Any, y0: Any, y1: Any) -> Any:
    left, right = x0 >> 3, x1 >> 3
    row, last = (y0 >> 3) * live_stride, (y1 >> 3) * live_stride
    total = peek(live, row + left) + peek(live, row + right)
    total += peek(live, last + left) + peek(live, last + right)
    if (right - left > 1) or (last - row > live_stride):
        while row <= last:
            for place in range(row + left, row + right + 1):
                total += peek(live, place)
            row += live_stride
    return total > 0


@inlined
def _row_spans(dy: Any, ellipse: Any, view: Any, xa: Any, xb: Any) -> Any:
    """Return, for eight rows, the first and last column that a splat may reach, packed.

    Solves A dx^2 + (B dy) dx + C dy^2 = limit for dx. The spans are a little wide: the threshold
    on alpha decides, here we only save work. An empty span has its last column at -1.
    """
    u, a, b, c, limit = ellipse
    half = dy * (b * np.float32(0.5))
    square = half * half
    inside = fma(square, 1.000001, negate(fma(dy * dy, c, -limit) * a))
    root = sqrt(maximum(inside, 0.0))
    inverse = np.float32(1.0) / a
    low = ceil(negate(half + root) * inverse + (u - np.float32(0.502)))
    high = floor((root - half) * inverse + (u + np.float32(0.502)))
    stride, inverse_stride = view[at.STRIDE], view[at.INVERSE_STRIDE]
    offset, block = view[at.OFFSET], view[at.BLOCK]
    origin = view[at.COLUMN0]
    first = taken_below(low, stride, inverse_stride, offset, block) - origin
    last = taken_below(high, stride, inverse_stride, offset, block) - (origin + np.float32(1.0))
    first = minimum(maximum(first, np.float32(xa)), 32767.0)
    last = where(inside > 0.0, minimum(last, np.float32(xb)), -1.0)
    return pack_range(first, maximum(last, -1.0))


@kernel
def clear(frame: Any, plane: Any, width: Any, height: Any, live: Any, live_stride: Any) -> Any:
    """Prepare a window: transmittance 1 inside width x height, -1 outside, the rest 0."""
    row = PLANES * plane
    for y in range(height + SLACK_ROWS):
        for x in range(plane):
            frame[y * row + x] = np.float32(1.0) if x < width and y < height else np.float32(-1.0)
        for x in range(plane, row):
            frame[y * row + x] = np.float32(0.0)
    for y in range((height + 7) // 8 + 1):
        for x in range(live_stride):
            inside = max(0, min(8, width - 8 * x)) * max(0, min(8, height - 8 * y))
            live[y * live_stride + x] = inside


@kernel
def blend(  # noqa: C901, PLR0912 - three shapes of splat in one loop, each a few lines.
    records: Any,
    ordered: Any,
    count: Any,
    columns: Any,
    rows: Any,
    frame: Any,
    plane: Any,
    live: Any,
    live_stride: Any,
    view: Any,
    most_alpha: Any,
) -> Any:
    """Blend splats into a window.

    Args:
        records: float32 records of project.py.
        ordered: int64 keys, nearest first; record numbers in the lower halves.
        count: how many.
        columns: float32 pixel-centre coordinates of the window's columns, with slack.
        rows: likewise of its rows.
        frame: float32 framebuffer.
        plane: floats of one plane's row.
        live: int64 unfinished pixels of each 8x8 block of the window.
        live_stride: blocks per row.
        view: (SIZE,) float32 of view.py.
        most_alpha: alpha is clamped to it.

    Returns:
        (pixels that finished, vectors drawn, splats drawn).
    """
    row = PLANES * plane
    finished = vectors = drawn = 0
    spans = np.empty(8, np.float32)
    span_bits = spans.view(np.int32)
    for i in range(count):
        prefetch(records, (peek(ordered, min(i + AHEAD, count - 1)) & 0xFFFFFFFF) * RECORD)
        j = (peek(ordered, i) & 0xFFFFFFFF) * RECORD
        packed_x = int(bits_of(peek(records, j + COLUMNS)))
        packed_y = int(bits_of(peek(records, j + ROWS)))
        xa, xb = packed_x & 0xFFFF, packed_x >> 16
        ya, yb = packed_y & 0xFFFF, packed_y >> 16
        if not _any_live(live, live_stride, xa, xb, ya, yb):
            continue
        drawn += 1
        u, v = peek(records, j + U), peek(records, j + V)
        ca, cb, cc = peek(records, j + A), peek(records, j + B), peek(records, j + C)
        log_opacity = peek(records, j + LOG_OPACITY)
        colour = (
            broadcast(peek(records, j + RED)),
            broadcast(peek(records, j + GREEN)),
            broadcast(peek(records, j + BLUE)),
            broadcast(peek(records, j + DEPTH)),
        )
        # power = log_opacity - dx (A dx) - dy (B dx + C dy), always in this order.
        if xb - xa < 4:
            dx = load_rows(columns, xa, xa) - u
            across = fma(negate(dx * ca), dx, log_opacity)
            slope = dx * cb
            o = ya * row + xa
            for y in range(ya, yb + 1, 2):
                dy = halves(peek(rows, y), peek(rows, y + 1)) - v
                power = fma(negate(fma(dy, cc, slope)), dy, across)
                bits = _draw_rows(frame, o, o + row, plane, power, most_alpha, colour)
                o += row + row
                vectors += 1
                while bits != 0:
                    lane = lowest_bit(bits)
                    bits &= bits - 1
                    _retire(live, live_stride, xa + (lane & 3), y + (lane >> 2))
                    finished += 1
        elif xb - xa < 8:
            dx = load(columns, xa) - u
            across = fma(negate(dx * ca), dx, log_opacity)
            slope = dx * cb
            o = ya * row + xa
            for y in range(ya, yb + 1, 2):
                dy = broadcast(peek(rows, y) - v)
                below = broadcast(peek(rows, y + 1) - v)
                power = fma(negate(fma(dy, cc, slope)), dy, across)
                bits = _draw8(frame, o, plane, power, most_alpha, colour)
                power = fma(negate(fma(below, cc, slope)), below, across)
                bits |= _draw8(frame, o + row, plane, power, most_alpha, colour) << 8
                o += row + row
                vectors += 2
                while bits != 0:
                    lane = lowest_bit(bits)
                    bits &= bits - 1
                    _retire(live, live_stride, xa + (lane & 7), y + (lane >> 3))
                    finished += 1
        else:
            for y in range(ya, yb + 1):
                if (y - ya) & 7 == 0:
                    dy = load(rows, y) - v
                    ellipse = (u, ca, cb, cc, log_opacity - THRESHOLD)
                    store(spans, 0, _row_spans(dy, ellipse, view, xa, xb))
                bits = int(peek(span_bits, (y - ya) & 7))
                dy = broadcast(peek(rows, y) - v)
                for x in range(bits & 0xFFFF, (bits >> 16) + 1, 8):
                    dx = load(columns, x) - u
                    across = fma(negate(dx * ca), dx, log_opacity)
                    power = fma(negate(fma(dy, cc, dx * cb)), dy, across)
                    bits_done = _draw8(frame, y * row + x, plane, power, most_alpha, colour)
                    vectors += 1
                    while bits_done != 0:
                        lane = lowest_bit(bits_done)
                        bits_done &= bits_done - 1
                        _retire(live, live_stride, x + lane, y)
                        finished += 1
    return finished, vectors, drawn
