"""Front-to-back compositing, splat by splat, into a framebuffer small enough for the cache.

For a pixel with transmittance T and a splat with alpha: when T (1 - alpha) <= 1e-4 the pixel is
finished and the splat is not added; otherwise colour += T alpha c, T -= T alpha. Splats with
alpha < 1/255 are skipped. This is gsplat's rule, in gsplat's order.

The framebuffer is two arrays, row by row with `stride` pixels in a row; `place` counts pixels.
`light` has one float for each pixel: the light T that it still lets through. `paint` has four: red,
green, blue, depth. A finished pixel holds -T. Pixels outside the window hold -1.

What lies behind finished pixels is left out, a half to two thirds of a large splat's vectors and a
third of the small splats (measured). Two maps say what is not finished: a bit for each pixel, which
whole numbers alone ask, long before the lanes are needed; and `live`, the number in each 8x8 block,
for large splats and for chunks. They are made anew for every `BATCH` splats: until then a splat may
be drawn on finished pixels, which changes none of them, and none has to note which it finished.

Each splat is drawn with the shape of vector that fits it: 4x2 pixels for splats up to four
wide and two high, 4x4 for up to four wide, 8x2 for up to eight, 16x1 for up to sixteen, and row
spans solved from its ellipse for the others. All evaluate the same expression in the same order, so
a pixel's bits do not depend on the shape.
"""

# ruff: noqa: ARG001 - an intrinsic sees the types of its arguments; their values reach `generate`.
from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types

from nw_base.machine_code import inlined, kernel
from nw_base.simd.lanes import (
    FLOAT,
    I64,
    Float8,
    Floats16,
    address,
    broadcast,
    broadcast8,
    call_llvm,
    ceil,
    floor,
    fma,
    intrinsic,
    joined,
    lane_list,
    mask_bits,
    maximum,
    minimum,
    minus_abs,
    negate,
    sqrt,
    where,
)
from nw_base.simd.memory import elements, load, peek, poke, prefetch, store
from nw_splat.kernels import view as at
from nw_splat.kernels.math8 import (
    EXP2,
    bits_of,
    count_bits,
    exp2,
    pack_range,
    taken_below,
    word_at,
)
from nw_splat.kernels.project import (
    BEND,
    COLUMNS,
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

PIXELS = 16
CHANNELS = 4

FINISHED = 1e-4
"""Transmittance at which a pixel takes no more splats."""

AHEAD = 10
"""Splats by which records are fetched ahead of their use."""

BATCH = 4096
"""Splats, at least, between two looks at the pixels that are left."""

SLACK_BYTES, SLACK_LINES = 4, 8
"""Bytes behind each row of a map of pixels, and rows below it, that words may touch."""

SLACK_COLUMNS, SLACK_ROWS = 16, 4
"""Columns and rows behind the window that vectors may touch; their pixels count as finished."""

CURVE = np.array([THRESHOLD, FINISHED, *EXP2], dtype=np.float32)
"""Numbers that `blend` keeps in registers; `math8.exp2` says why they are none of its constants."""


_LANES = {8: (Float8, broadcast8), PIXELS: (Floats16, broadcast)}
"""What holds so many pixels, and what fills it with one float."""


def _vector(lanes: int) -> Any:
    return ir.VectorType(FLOAT, lanes)


def _floats_at(builder: Any, pointer: Any, lanes: int) -> Any:
    return builder.bitcast(pointer, _vector(lanes).as_pointer())


def _spread(builder: Any, vector: Any, lanes: list[int]) -> Any:
    return builder.shuffle_vector(vector, ir.Constant(vector.type, ir.Undefined), lane_list(lanes))


@dataclass(frozen=True, kw_only=True)
class LaneShape:
    """Operations on a block of pixels; each member is an intrinsic.

    Attributes:
        fill: (value): one float in the lanes of all pixels.
        columns: (array, x): the columns' values, from x on, of all pixels.
        rows: (array, y): as above, of the rows.
        load: (light, place, stride): the light of the pixels.
        store: (light, place, stride, value): write it.
        add: (paint, place, stride, weight, colour): add weight * colour to the paint; `colour`
            holds the four channels four times, as `repeat4` returns them.
    """

    fill: Any
    columns: Any
    rows: Any
    load: Any
    store: Any
    add: Any


def _row_places(builder: Any, place: Any, stride: Any, rows: int) -> list[Any]:
    places = [place]
    for _ in range(1, rows):
        places.append(builder.add(places[-1], stride))
    return places


def _laying(count: int, lanes: list[int]) -> Any:
    """Return the intrinsic that takes `count` floats of an array to lanes."""

    @intrinsic
    def lay(_typing: Any, array: Any, index: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            place = address(context, builder, signature.args[0], args[0], args[1])
            return _spread(builder, builder.load(_floats_at(builder, place, count), align=4), lanes)

        return _LANES[len(lanes)][0](array, types.intp), generate

    return lay


def _loading(rows: int, width: int) -> Any:
    @intrinsic
    def load(_typing: Any, light: Any, place: Any, stride: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            parts: list[Any] = []
            for start in _row_places(builder, args[1], args[2], rows):
                pointer = address(context, builder, signature.args[0], args[0], start)
                parts.append(builder.load(_floats_at(builder, pointer, width), align=4))
            return joined(builder, parts)

        return _LANES[rows * width][0](light, types.intp, types.intp), generate

    return load


def _storing(rows: int, width: int) -> Any:
    @intrinsic
    def store(_typing: Any, light: Any, place: Any, stride: Any, value: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            for row, start in enumerate(_row_places(builder, args[1], args[2], rows)):
                pointer = address(context, builder, signature.args[0], args[0], start)
                part = _spread(builder, args[3], list(range(row * width, (row + 1) * width)))
                builder.store(part, _floats_at(builder, pointer, width), align=4)
            return context.get_dummy_value()

        kind, _ = _LANES[rows * width]
        return types.void(light, types.intp, types.intp, kind), generate

    return store


def _adding(rows: int, width: int) -> Any:
    @intrinsic
    def add(_typing: Any, paint: Any, place: Any, stride: Any, weight: Any, colour: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            first, step = (builder.mul(value, ir.Constant(I64, CHANNELS)) for value in args[1:3])
            starts = _row_places(builder, first, step, rows)
            for pixel in range(0, rows * width, CHANNELS):
                column = ir.Constant(I64, CHANNELS * (pixel % width))
                start = builder.add(starts[pixel // width], column)
                place = address(context, builder, signature.args[0], args[0], start)
                pointer = _floats_at(builder, place, PIXELS)
                lanes = [pixel + lane // CHANNELS for lane in range(PIXELS)]
                there = builder.load(pointer, align=4)
                share = _spread(builder, args[3], lanes)
                value = call_llvm(builder, "fmuladd", share, args[4], there)
                builder.store(value, pointer, align=4)
            return context.get_dummy_value()

        kind, _ = _LANES[rows * width]
        return types.void(paint, types.intp, types.intp, kind, Floats16), generate

    return add


def _shape(width: int, rows: int) -> LaneShape:
    pixels = width * rows
    return LaneShape(
        fill=_LANES[pixels][1],
        columns=_laying(width, list(range(width)) * rows),
        rows=_laying(rows, [lane // width for lane in range(pixels)]),
        load=_loading(rows, width),
        store=_storing(rows, width),
        add=_adding(rows, width),
    )


repeat4 = _laying(CHANNELS, list(range(CHANNELS)) * (PIXELS // CHANNELS))
"""(array, index): array[index : index + 4] four times."""


BRICK, SQUARE, FLAT, LINE = _shape(4, 2), _shape(4, 4), _shape(8, 2), _shape(16, 1)


def _drawing(shape: LaneShape) -> Any:
    load, store_light, add = shape.load, shape.store, shape.add

    @inlined
    def draw(
        light: Any, paint: Any, o: Any, stride: Any, power: Any, curve: Any, colour: Any
    ) -> None:
        """Blend a block of pixels, the first at o."""
        threshold, finished, most_alpha, numbers = curve
        T = load(light, o, stride)
        # Rounding can lift the power of a needle above 0; nothing is more than opaque.
        alpha = minimum(exp2(minimum(power, 0.0), numbers), most_alpha)
        weight = where(power >= threshold, alpha * T, 0.0)
        left = T - weight
        # True for all that have finished before, too.
        finish = left <= finished
        store_light(light, o, stride, where(finish, minus_abs(T), left))
        add(paint, o, stride, where(finish, 0.0, weight), colour)

    return draw


_draw_square, _draw_flat, _draw_line = _drawing(SQUARE), _drawing(FLAT), _drawing(LINE)
_blend_brick = _drawing(BRICK)


@kernel
def _note_unfinished(
    light: Any, stride: Any, live: Any, live_stride: Any, rowwise: Any, fourfold: Any
) -> Any:
    """Make the maps of the pixels that are not finished.

    Args:
        light: float32, T of each pixel.
        stride: pixels in a row, slack included.
        live: int64, out: their number in each 8x8 block of the window.
        live_stride: blocks per row.
        rowwise: uint8, out: a bit for each pixel, `live_stride` + `SLACK_BYTES` bytes to a row.
        fourfold: uint8, out: as above, a row and the three below it in one.

    Returns:
        How many there are in all.
    """
    total = 0
    rows, width = len(light) // stride, live_stride + SLACK_BYTES
    for row in range(len(live) // live_stride - 1):
        for column in range(live_stride - 1):
            count = 0
            for y in range(8 * row, min(8 * row + 8, rows)):
                bits = mask_bits(load(light, y * stride + 8 * column) > 0.0)
                poke(rowwise, y * width + column, np.uint8(bits))
                count += count_bits(bits)
            poke(live, row * live_stride + column, count)
            total += count
    for index in range(rows * width):
        first = peek(rowwise, index) | peek(rowwise, index + width)
        last = peek(rowwise, index + 2 * width) | peek(rowwise, index + 3 * width)
        poke(fourfold, index, first | last)
    return total


@kernel
def _any_live(live: Any, live_stride: Any, x0: Any, x1: Any, y0: Any, y1: Any) -> Any:
    left, right = x0 >> 3, x1 >> 3
    row, last = (y0 >> 3) * live_stride, (y1 >> 3) * live_stride
    total = peek(live, row + left) + peek(live, row + right)
    total += peek(live, last + left) + peek(live, last + right)
    if (right - left > 1) or (last - row > live_stride):
        while row <= last:
            for index in range(row + left, row + right + 1):
                total += peek(live, index)
            row += live_stride
    return total > 0


@inlined
def columns_part(ray: Any, dx: Any, a: Any, b: Any, log_opacity: Any, slope_x: Any) -> Any:
    """Return what a pixel's column adds to its power: along x, for each row, and m's part."""
    if ray is None:
        return fma(negate(dx * a), dx, log_opacity), dx * b, dx
    return dx * a * dx, dx * b, fma(dx, slope_x, 1.0)


def _placing(shape: LaneShape) -> Any:
    columns, rows, load = shape.columns, shape.rows, shape.load

    @inlined
    def across(lens: Any, xs: Any, x: Any, o: Any, stride: Any) -> Any:
        """Return where the pixels of a block lie from left to right."""
        if lens is None:
            return columns(xs, x)
        return load(xs, o, stride)

    @inlined
    def down(lens: Any, ys: Any, y: Any, o: Any, stride: Any) -> Any:
        """Return the same from the top."""
        if lens is None:
            return rows(ys, y)
        return load(ys, o, stride)

    @inlined
    def next_columns(
        lens: Any, before: Any, ray: Any, xs: Any, o: Any, stride: Any, splat: Any
    ) -> Any:
        """Return `columns_part` for the next rows: the same ones, but through a lens."""
        if lens is None:
            return before
        u, a, b, log_opacity, slope_x = splat
        return columns_part(ray, load(xs, o, stride) - u, a, b, log_opacity, slope_x)

    @inlined
    def next_rows(lens: Any, before: Any, ys: Any, o: Any, stride: Any, v: Any) -> Any:
        """Return where the next columns lie from the top: as those before, but through a lens."""
        if lens is None:
            return before
        return load(ys, o, stride) - v

    return across, down, next_columns, next_rows


_brick_across, _brick_down, _, _ = _placing(BRICK)
_square_across, _square_down, _square_next, _ = _placing(SQUARE)
_flat_across, _flat_down, _flat_next, _ = _placing(FLAT)
_line_across, _line_down, _line_next, _line_along = _placing(LINE)


@inlined
def _power(ray: Any, dy: Any, of_columns: Any, splat: Any) -> Any:
    """Return log2 of the alpha of pixels: the formulas of project.py, always in this order."""
    across, slope, lean = of_columns
    c, log_opacity, slope_y, bend = splat
    if ray is None:
        return fma(negate(fma(dy, c, slope)), dy, across)
    e = fma(fma(dy, c, slope), dy, across)
    m = maximum(fma(dy, slope_y, lean), 0.0)
    return log_opacity - e / fma(e, bend, m * m)


def _spreading(shape: LaneShape) -> Any:
    fill = shape.fill

    @inlined
    def spread_curve(numbers: Any, most_alpha: Any) -> Any:
        """Return what `draw` takes of `CURVE`."""
        return (
            fill(numbers[0]),
            fill(numbers[1]),
            fill(most_alpha),
            (
                fill(numbers[2]),
                fill(numbers[3]),
                fill(numbers[4]),
                fill(numbers[5]),
                fill(numbers[6]),
                fill(numbers[7]),
                fill(numbers[8]),
            ),
        )

    @inlined
    def spread_splat(ray: Any, splats: Any, j: Any) -> Any:
        """Return what a splat's power is computed of: by columns, by rows, and its middle's row."""
        log_opacity = fill(peek(splats, j + LOG_OPACITY))
        of_columns = (
            fill(peek(splats, j + U)),
            fill(peek(splats, j + A)),
            fill(peek(splats, j + B)),
            log_opacity,
            log_opacity if ray is None else fill(peek(splats, j + SLOPE_X)),
        )
        of_rows = (
            fill(peek(splats, j + C)),
            log_opacity,
            log_opacity if ray is None else fill(peek(splats, j + SLOPE_Y)),
            log_opacity if ray is None else fill(peek(splats, j + BEND)),
        )
        return of_columns, of_rows, fill(peek(splats, j + V))

    return spread_curve, spread_splat


_spread_curve, _spread_splat = _spreading(SQUARE)
_brick_curve, _spread_over_brick = _spreading(BRICK)


@inlined
def _draw_brick(
    light: Any, paint: Any, lens: Any, ray: Any, xs: Any, ys: Any, x: Any, y: Any, stride: Any,
    splats: Any, j: Any, curve: Any,
) -> None:  # fmt: skip
    """Blend a splat that one such block of pixels holds."""
    o = y * stride + x
    (u, a, b, log_opacity, slope_x), of_rows, v = _spread_over_brick(ray, splats, j)
    dx = _brick_across(lens, xs, x, o, stride) - u
    of_columns = columns_part(ray, dx, a, b, log_opacity, slope_x)
    power = _power(ray, _brick_down(lens, ys, y, o, stride) - v, of_columns, of_rows)
    _blend_brick(light, paint, o, stride, power, curve, repeat4(splats, j + RED))


@inlined
def row_spans(ray: Any, dy: Any, outline: Any, view: Any, xa: Any, xb: Any) -> Any:
    """Return, for eight rows, the first and last column that a splat may reach, packed.

    Solves A dx^2 + (B dy) dx + C dy^2 = limit for dx; along the ray, with the right side
    limit (k e + m^2), a quadratic too, which may bound nothing. The spans are a little wide: the
    threshold on alpha decides, here we only save work. An empty span has its last column at -1.
    """
    u, a, b, c, limit, slope_x, slope_y, bend = outline
    half = dy * (b * np.float32(0.5))
    is_bounded = True
    if ray is None:
        square = half * half
        inside = fma(square, 1.000001, negate(fma(dy * dy, c, -limit) * a))
        inverse = np.float32(1.0) / a
        slack = np.float32(0.502)
    else:
        share = np.float32(1.0) - limit * bend
        limit = limit / max(share, np.float32(1e-6))
        leading = a - limit * slope_x * slope_x
        is_bounded = (share > np.float32(1e-3)) & (leading > np.float32(1e-3) * a)
        m = fma(dy, slope_y, 1.0)
        half = fma(m, -limit * slope_x, half)
        rest = fma(dy * dy, c, m * m * -limit)
        square = half * half
        inside = fma(square, 1.00001, negate(rest * leading))
        inverse = np.float32(1.0) / leading
        slack = np.float32(0.52)
    root = sqrt(maximum(inside, 0.0))
    low = ceil(negate(half + root) * inverse + (u - slack))
    high = floor((root - half) * inverse + (u + slack))
    stride, inverse_stride = view[at.STRIDE], view[at.INVERSE_STRIDE]
    offset, block = view[at.OFFSET], view[at.BLOCK]
    if stride != 1.0:
        low = taken_below(low, stride, inverse_stride, offset, block)
        high = taken_below(high, stride, inverse_stride, offset, block)
    origin = view[at.COLUMN0]
    first = minimum(maximum(low - origin, np.float32(xa)), 32767.0)
    last = high - (origin + np.float32(1.0))
    last = where(inside > 0.0, minimum(last, np.float32(xb)), -1.0)
    if not is_bounded:
        first, last = dy * 0.0 + np.float32(xa), dy * 0.0 + np.float32(xb)
    return pack_range(first, maximum(last, -1.0))


@inlined
def _spans(
    lens: Any, ray: Any, ys: Any, y: Any, v: Any, outline: Any, view: Any, xa: Any, xb: Any
) -> Any:
    """As `row_spans`, from row y on; through a lens all of the box."""
    below = load(ys, y) - v
    if lens is None:
        return row_spans(ray, below, outline, view, xa, xb)
    return pack_range(below * 0.0 + np.float32(xa), below * 0.0 + np.float32(xb))


@kernel
def clear(
    light: Any, paint: Any, stride: Any, width: Any, height: Any, live: Any, live_stride: Any
) -> None:
    """Prepare a window: transmittance 1 inside width x height, -1 outside, the rest 0."""
    for y in range(height + SLACK_ROWS):
        for x in range(stride):
            light[y * stride + x] = np.float32(1.0) if x < width and y < height else np.float32(-1)
    paint[: (height + SLACK_ROWS) * stride * CHANNELS] = np.float32(0.0)
    for y in range((height + 7) // 8 + 1):
        for x in range(live_stride):
            inside = max(0, min(8, width - 8 * x)) * max(0, min(8, height - 8 * y))
            live[y * live_stride + x] = inside


@kernel
def blend(  # noqa: C901, PLR0912 - four shapes of splat in one loop, each a few lines.
    records: Any,
    ordered: Any,
    count: Any,
    columns: Any,
    rows: Any,
    light: Any,
    paint: Any,
    stride: Any,
    live: Any,
    live_stride: Any,
    view: Any,
    most_alpha: Any,
    ray: Any,
    lens: Any,
    numbers: Any,
) -> Any:
    """Blend splats into a window.

    Args:
        records: float32 records of project.py.
        ordered: int64 keys, nearest first; record numbers in the lower halves.
        count: how many.
        columns: float32 pixel-centre coordinates of the window's columns, with slack.
        rows: as above, of its rows.
        light: float32, T of each pixel.
        paint: float32, four for each pixel.
        stride: pixels in a row of the two, slack included.
        live: int64, out: unfinished pixels of each 8x8 block of the window; one more block in each
            row and column than the window has.
        live_stride: blocks per row.
        view: (SIZE,) float32 of view.py.
        most_alpha: alpha is clamped to it.
        ray: None for EWA, anything else along the ray: two compiled kernels.
        lens: None for a pinhole, else columns and rows have a value for each pixel of the window.
        numbers: `CURVE`.

    Returns:
        (pixels that are not finished, vectors drawn, splats drawn).
    """
    vectors = drawn = 0
    spans = np.empty(8, np.float32)
    span_bits = spans.view(np.int32)
    curve = _spread_curve(numbers, most_alpha)
    brick_curve = _brick_curve(numbers, most_alpha)
    batch = max(BATCH, len(light) // 4)
    width = live_stride + SLACK_BYTES
    maps = np.zeros((2, (len(light) // stride + SLACK_LINES) * width), np.uint8)
    left = _note_unfinished(light, stride, live, live_stride, maps[0], maps[1])
    T, colours, rowwise, fourfold = (
        elements(light),
        elements(paint),
        elements(maps[0]),
        elements(maps[1]),
    )
    splats, order, xs, ys, blocks = (
        elements(records),
        elements(ordered),
        elements(columns),
        elements(rows),
        elements(live),
    )
    for start in range(0, count, batch):
        if left == 0:
            break
        for i in range(start, min(start + batch, count)):
            prefetch(splats, (peek(order, min(i + AHEAD, count - 1)) & 0xFFFFFFFF) * RECORD)
            j = (peek(order, i) & 0xFFFFFFFF) * RECORD
            packed_x = int(bits_of(peek(splats, j + COLUMNS)))
            packed_y = int(bits_of(peek(splats, j + ROWS)))
            xa, xb = packed_x & 0xFFFF, packed_x >> 16
            ya, yb = packed_y & 0xFFFF, packed_y >> 16
            if (xb - xa < 8) & (yb - ya < 8):
                place = ya * width + (xa >> 3)
                bits = word_at(fourfold, place) | word_at(fourfold, place + 4 * width)
                if (bits >> (xa & 7)) & ((2 << (xb - xa)) - 1) == 0:
                    continue
            # The first block alone answers for most.
            elif peek(blocks, (ya >> 3) * live_stride + (xa >> 3)) == 0 and not _any_live(
                live, live_stride, xa, xb, ya, yb
            ):
                continue
            drawn += 1
            # Most splats of a small picture. For one row, 4x1 is no faster (measured).
            if (xb - xa < 4) & (yb - ya < 2):
                _draw_brick(T, colours, lens, ray, xs, ys, xa, ya, stride, splats, j, brick_curve)
                vectors += 1
                continue
            place_of, splat, v = _spread_splat(ray, splats, j)
            u, ca, cb, log_opacity, slope_x = place_of
            colour = repeat4(splats, j + RED)
            o = ya * stride + xa
            if xb - xa < 4:
                dx = _square_across(lens, xs, xa, o, stride) - u
                of_columns = columns_part(ray, dx, ca, cb, log_opacity, slope_x)
                # Most need one: outside the loop, whose places would be laid out for many.
                dy = _square_down(lens, ys, ya, o, stride) - v
                power = _power(ray, dy, of_columns, splat)
                _draw_square(T, colours, o, stride, power, curve, colour)
                vectors += 1
                for y in range(ya + 4, yb + 1, 4):
                    o += 4 * stride
                    dy = _square_down(lens, ys, y, o, stride) - v
                    of_columns = _square_next(lens, of_columns, ray, xs, o, stride, place_of)
                    power = _power(ray, dy, of_columns, splat)
                    _draw_square(T, colours, o, stride, power, curve, colour)
                    vectors += 1
            elif xb - xa < 8:
                dx = _flat_across(lens, xs, xa, o, stride) - u
                of_columns = columns_part(ray, dx, ca, cb, log_opacity, slope_x)
                y = ya
                while True:
                    dy = _flat_down(lens, ys, y, o, stride) - v
                    of_columns = _flat_next(lens, of_columns, ray, xs, o, stride, place_of)
                    power = _power(ray, dy, of_columns, splat)
                    _draw_flat(T, colours, o, stride, power, curve, colour)
                    o += 2 * stride
                    y += 2
                    vectors += 1
                    if y > yb:
                        break
            elif xb - xa < 16:
                dx = _line_across(lens, xs, xa, o, stride) - u
                of_columns = columns_part(ray, dx, ca, cb, log_opacity, slope_x)
                for y in range(ya, yb + 1):
                    dy = _line_down(lens, ys, y, o, stride) - v
                    of_columns = _line_next(lens, of_columns, ray, xs, o, stride, place_of)
                    power = _power(ray, dy, of_columns, splat)
                    _draw_line(T, colours, o, stride, power, curve, colour)
                    o += stride
                    vectors += 1
            else:
                for y in range(ya, yb + 1):
                    if (y - ya) & 7 == 0:
                        outline = (
                            peek(splats, j + U),
                            peek(splats, j + A),
                            peek(splats, j + B),
                            peek(splats, j + C),
                            peek(splats, j + LOG_OPACITY) - THRESHOLD,
                            peek(splats, j + SLOPE_X),
                            peek(splats, j + SLOPE_Y),
                            peek(splats, j + BEND),
                        )
                        below = peek(splats, j + V)
                        store(spans, 0, _spans(lens, ray, ys, y, below, outline, view, xa, xb))
                    packed = int(peek(span_bits, (y - ya) & 7))
                    dy = _line_down(lens, ys, y, y * stride, stride) - v
                    for x in range(packed & 0xFFFF, (packed >> 16) + 1, 16):
                        bits = word_at(rowwise, y * width + (x >> 3)) >> (x & 7)
                        if bits & 0xFFFF == 0:
                            continue
                        dy = _line_along(lens, dy, ys, y * stride + x, stride, v)
                        dx = _line_across(lens, xs, x, y * stride + x, stride) - u
                        of_columns = columns_part(ray, dx, ca, cb, log_opacity, slope_x)
                        power = _power(ray, dy, of_columns, splat)
                        _draw_line(T, colours, y * stride + x, stride, power, curve, colour)
                        vectors += 1
        left = _note_unfinished(light, stride, live, live_stride, maps[0], maps[1])
    return left, vectors, drawn
