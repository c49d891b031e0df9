"""One window of one frame: slabs of depth, nearest first, through project, sort and blend.

Chunks are taken in the order of their nearest point, some at a time: a slab. Every Gaussian
nearer than the nearest point of the chunks not yet taken can be blended, since nothing comes
before it; the others are carried to the next slab. A chunk whose blocks are all finished when its
turn comes is skipped before a byte of it is read, and the frame ends when no pixel is left. The
order of blending is the order of depth, as if everything had been sorted at once.

A slab is sorted exactly: radix sort on all 32 bits of the depth. Non-negative floats order like
their bit patterns. Keys are int64: pattern less the smallest pattern in the upper half, index in
the lower. Least-significant-digit radix sort is stable, so equal depths keep the order of the
store. Sixteen-bit keys would cost 40 dB (measured).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from nw_base.machine_code import inlined, kernel, part
from nw_base.simd.memory import load, peek, poke, store
from nw_splat.kernels import view as at
from nw_splat.kernels.blend import CHANNELS, SLACK_COLUMNS, blend, clear
from nw_splat.kernels.cull import is_hidden, visible_chunks
from nw_splat.kernels.math8 import bits_of, clock_nanoseconds, float_of
from nw_splat.kernels.project import (
    BLUE,
    COLUMNS,
    DEPTH,
    GREEN,
    RECORD,
    RED,
    ROWS,
    SLOPE_X,
    SLOPE_Y,
    U,
    V,
    project_chunk,
    widest,
)

DIGIT = 13
"""Most bits of a digit."""

HISTOGRAM = 3 << DIGIT
"""Elements of the histogram that the sort works in: three digits hold any 32 bits."""


@inlined
def _digits(span: Any) -> Any:
    """Return (number of digits, bits of each) for keys from 0 to `span`."""
    bits = 1
    while (span >> bits) != 0:
        bits += 1
    digits = (bits + DIGIT - 1) // DIGIT
    return digits, (bits + digits - 1) // digits


@inlined
def _count_digits(keys: Any, count: Any, digits: Any, width: Any, histogram: Any) -> None:
    """Count the values of each digit; the number of digits is no loop within the loop."""
    mask = (1 << width) - 1
    second, third = 32 + width, 32 + 2 * width
    for i in range(digits << DIGIT):
        poke(histogram, i, 0)
    if digits == 1:
        for i in range(count):
            _increment(histogram, (peek(keys, i) >> 32) & mask)
    elif digits == 2:
        for i in range(count):
            key = peek(keys, i)
            _increment(histogram, (key >> 32) & mask)
            _increment(histogram, (1 << DIGIT) + ((key >> second) & mask))
    else:
        for i in range(count):
            key = peek(keys, i)
            _increment(histogram, (key >> 32) & mask)
            _increment(histogram, (1 << DIGIT) + ((key >> second) & mask))
            _increment(histogram, (2 << DIGIT) + ((key >> third) & mask))


@inlined
def _increment(histogram: Any, place: Any) -> None:
    poke(histogram, place, peek(histogram, place) + 1)


@kernel
def sort_keys(keys: Any, scratch: Any, count: Any, span: Any, histogram: Any) -> Any:
    """Sort int64 keys by their upper halves, which lie in 0..span.

    Returns:
        Whether the sorted keys stand in `scratch`; otherwise they stand in `keys`.
    """
    digits, width = _digits(span)
    mask = (1 << width) - 1
    _count_digits(keys, count, digits, width, histogram)
    source, target = keys, scratch
    for digit in range(digits):
        base = digit << DIGIT
        total = 0
        for j in range(base, base + mask + 1):
            size = peek(histogram, j)
            poke(histogram, j, total)
            total += size
        shift = 32 + digit * width
        for i in range(count):
            key = peek(source, i)
            place = base + ((key >> shift) & mask)
            slot = peek(histogram, place)
            poke(target, slot, key)
            poke(histogram, place, slot + 1)
        source, target = target, source
    return (digits & 1) == 1


@kernel
def note_depths(records: Any, first: Any, end: Any, depths: Any) -> None:
    """Copy the depths of records first..end-1, while they are in the nearest cache."""
    for i in range(first, end):
        poke(depths, i, peek(records, i * RECORD + DEPTH))


@kernel
def sort_nearer(
    depths: Any, count: Any, boundary: Any, keys: Any, scratch: Any, carried: Any, histogram: Any
) -> Any:
    """Order the records nearer than `boundary`; note the others.

    Args:
        depths: float32, of the records.
        count: how many.
        boundary: depth from which on records are left for later.
        keys: int64 to sort in.
        scratch: int64 to sort in.
        carried: int64, out: record numbers at or beyond the boundary, in order.
        histogram: (HISTOGRAM,) int64.

    Returns:
        (records sorted, whether they stand in `scratch`, records carried).
    """
    limit = int(bits_of(boundary))
    least, most = limit, 0
    near = later = 0
    # Without a branch: which side of the boundary comes next cannot be foreseen.
    for i in range(count):
        bits = int(bits_of(peek(depths, i)))
        poke(keys, near, (bits << 32) | i)
        poke(carried, later, i)
        nearer = int(bits < limit)
        near += nearer
        later += 1 - nearer
        least = min(least, bits)
        most = max(most, min(bits, limit - 1))
    if near == 0:
        return 0, False, later
    base = least << 32
    for i in range(near):
        poke(keys, i, peek(keys, i) - base)
    return near, sort_keys(keys, scratch, near, most - least, histogram), later


# Places in the statistics vector (int64); stages in nanoseconds of the given clock.
CULL, PROJECT, SORT, BLEND = 0, 1, 2, 3
VISIBLE_CHUNKS, HIDDEN_CHUNKS, RECORDS, VECTORS, DRAWN = 4, 5, 6, 7, 8
STATISTICS = 16


@kernel
def _order_chunks(nearest: Any, count: Any, keys: Any, scratch: Any, histogram: Any) -> Any:
    """Sort the visible chunks by nearest depth; keys come back in `keys`, chunk in lower half."""
    least, most = 0x7FFFFFFF, 0
    for i in range(count):
        bits = int(bits_of(nearest[i]))
        least, most = min(least, bits), max(most, bits)
    for i in range(count):
        keys[i] |= (int(bits_of(nearest[i])) - least) << 32
    if sort_keys(keys, scratch, count, most - least, histogram):
        for i in range(count):
            keys[i] = scratch[i]
    return least


@inlined
def nearest_of(key: Any, least: Any) -> Any:
    """Return the depth in the upper half of a chunk key."""
    return float_of((key >> 32) + least)


@kernel
def _keep_carried(records: Any, depths: Any, carried: Any, count: Any) -> None:
    """Move the carried records to the front, in their order."""
    for i in range(count):
        record = peek(carried, i)
        poke(depths, i, peek(depths, record))
        source, target = record * RECORD, i * RECORD
        first, second = load(records, source), load(records, source + 8)
        store(records, target, first)
        store(records, target + 8, second)


@kernel
def _resolve(
    light: Any,
    paint: Any,
    stride: Any,
    width: Any,
    height: Any,
    background: Any,
    out: Any,
    x0: Any,
    y0: Any,
) -> None:
    rgb, depth, alpha = out
    for y in range(height):
        for x in range(width):
            o = y * stride + x
            T = abs(peek(light, o))
            for channel in range(3):
                value = peek(paint, CHANNELS * o + channel) + T * background[channel]
                rgb[y0 + y, x0 + x, channel] = value
            covered = np.float32(1.0) - T
            alpha[y0 + y, x0 + x] = covered
            depth[y0 + y, x0 + x] = peek(paint, CHANNELS * o + 3) / max(covered, np.float32(1e-10))


@part
def _place_of(lens: Any, view: Any) -> Any:
    """Return the first column and row of the window, its width and its height."""
    if lens is None:
        x0, y0 = int(view[at.COLUMN0]), int(view[at.ROW0])
        return x0, y0, int(view[at.COLUMN1]) - x0, int(view[at.ROW1]) - y0
    place = lens[2]
    return place[0], place[1], place[2], place[3]


@part
def _blur_of(lens: Any) -> Any:
    if lens is None:
        return None
    return lens[1]


@part
def _widest_of(eps2d: Any, blur: Any) -> Any:
    return widest(eps2d, blur)


@part
def _is_hidden(
    lens: Any, bounds: Any, chunk: Any, view: Any, eps2d: Any, ray: Any, live: Any, live_stride: Any
) -> Any:
    """As `is_hidden`; through a lens no chunk is known to be."""
    if lens is None:
        return is_hidden(bounds, chunk, view, eps2d, ray, live, live_stride)
    return False


@kernel
def _through_lens(lens: Any, records: Any, first: Any, end: Any) -> Any:
    """Turn boxes of a pinhole's picture into boxes of pixels; records without a pixel go.

    Args:
        lens: None, or (tables, ...) of render.py.
        records: float32 records.
        first: the first one.
        end: behind the last one.

    Returns:
        The new end.
    """
    if lens is None:
        return end
    first_columns, last_columns, first_rows, last_rows = lens[0]
    kept = first
    for i in range(first, end):
        source, target = i * RECORD, kept * RECORD
        packed_x = int(bits_of(peek(records, source + COLUMNS)))
        packed_y = int(bits_of(peek(records, source + ROWS)))
        xa, xb = first_columns[packed_x & 0xFFFF], last_columns[packed_x >> 16]
        ya, yb = first_rows[packed_y & 0xFFFF], last_rows[packed_y >> 16]
        if xa > xb or ya > yb:
            continue
        front, back = load(records, source), load(records, source + 8)
        store(records, target, front)
        store(records, target + 8, back)
        poke(records, target + COLUMNS, float_of(xa | xb << 16))
        poke(records, target + ROWS, float_of(ya | yb << 16))
        kept += 1
    return kept


@kernel
def _as_surfaces(surface: Any, records: Any, first: Any, end: Any) -> None:
    """Put planes of inverse depth where colours are: at pixel (x, y), red + green x + blue y.

    The greatest response on a pixel's ray is at depth * m / (k e + m**2), with project.py's names;
    of a flat Gaussian, of which k is 0, at depth / m. There 1 / depth is a plane over the picture.

    Args:
        surface: None = leave the colours.
        records: float32 records along the ray.
        first: the first one.
        end: behind the last one.
    """
    if surface is not None:
        for i in range(first, end):
            place = i * RECORD
            inverse = np.float32(1.0) / peek(records, place + DEPTH)
            a, b = peek(records, place + SLOPE_X), peek(records, place + SLOPE_Y)
            at_origin = 1.0 - a * peek(records, place + U) - b * peek(records, place + V)
            poke(records, place + RED, np.float32(at_origin * inverse))
            poke(records, place + GREEN, np.float32(a * inverse))
            poke(records, place + BLUE, np.float32(b * inverse))


@kernel
def draw(
    store_arrays: Any,
    sh_count: Any,
    view: Any,
    columns: Any,
    rows: Any,
    options: Any,
    work: Any,
    out: Any,
    statistics: Any,
    clock: Any,
) -> None:
    """Render one window of a view.

    Args:
        store_arrays: (geometry, dc, sh, bounds) of the compiled store.
        sh_count: harmonics per channel.
        view: (SIZE,) float32 of view.py.
        columns: float32 pixel-centre coordinates of the window's columns, eight of slack.
        rows: as above, of its rows.
        options: (eps2d, antialiased, floor of the compensation squared, most alpha, None for EWA
            or True along the ray, None for a pinhole or (tables, blur, place) of render.py,
            numbers of the alpha curve, background (3,) float32, chunks in a slab, None for colours
            or True for surfaces, of which `out` has red, green and blue as `_as_surfaces` says).
            Through a lens the view is its pinhole's, and columns and rows are of all pixels.
        work: (keys, scratch, carried, chunk_keys, nearest, records, depths, histogram, light,
            paint, live): the workspace of render.py.
        out: (rgb, depth, alpha) of the whole image; the window's part is written.
        statistics: (STATISTICS,) int64, out.
        clock: POSIX clock for the stages, or -1 to take no time.
    """
    geometry, dc, sh, bounds = store_arrays
    eps2d, antialiased, floor2, most_alpha, ray, lens, numbers, background, slab, surface = options
    keys, scratch, carried, chunk_keys, nearest, records, depths, histogram, light, paint, live = (
        work
    )
    x0, y0, width, height = _place_of(lens, view)
    blur = _blur_of(lens)
    stride = width + SLACK_COLUMNS
    live_stride = (width + 7) // 8 + 1
    statistics[:] = 0
    started = clock_nanoseconds(clock) if clock >= 0 else 0
    clear(light, paint, stride, width, height, live, live_stride)
    visible = visible_chunks(bounds, view, _widest_of(eps2d, blur), chunk_keys, nearest)
    least = _order_chunks(nearest, visible, chunk_keys, scratch, histogram) if visible else 0
    statistics[VISIBLE_CHUNKS] = visible
    time = clock_nanoseconds(clock) if clock >= 0 else 0
    statistics[CULL] += time - started
    left, taken, count = width * height, 0, 0
    while left > 0 and (taken < visible or count > 0):
        started = time
        end = min(taken + slab, visible)
        for i in range(taken, end):
            chunk = chunk_keys[i] & 0xFFFFFFFF
            following = chunk_keys[min(i + 1, visible - 1)] & 0xFFFFFFFF
            if taken > 0 and _is_hidden(lens, bounds, chunk, view, eps2d, ray, live, live_stride):
                statistics[HIDDEN_CHUNKS] += 1
                continue
            before = count
            count = project_chunk(
                geometry,
                dc,
                sh,
                sh_count,
                bounds,
                chunk,
                following,
                view,
                eps2d,
                antialiased,
                floor2,
                ray,
                blur,
                records,
                count,
            )
            count = _through_lens(lens, records, before, count)
            _as_surfaces(surface, records, before, count)
            note_depths(records, before, count, depths)
            statistics[RECORDS] += count - before
        taken = end
        time = clock_nanoseconds(clock) if clock >= 0 else 0
        statistics[PROJECT] += time - started
        started = time
        boundary = np.float32(np.inf)
        if taken < visible:
            boundary = nearest_of(chunk_keys[taken], least)
        ready, in_scratch, later = sort_nearer(
            depths, count, boundary, keys, scratch, carried, histogram
        )
        ordered = scratch if in_scratch else keys
        time = clock_nanoseconds(clock) if clock >= 0 else 0
        statistics[SORT] += time - started
        started = time
        left, vectors, drawn = blend(
            records,
            ordered,
            ready,
            columns,
            rows,
            light,
            paint,
            stride,
            live,
            live_stride,
            view,
            most_alpha,
            ray,
            blur,
            numbers,
        )
        statistics[VECTORS] += vectors
        statistics[DRAWN] += drawn
        _keep_carried(records, depths, carried, later)
        count = later
        time = clock_nanoseconds(clock) if clock >= 0 else 0
        statistics[BLEND] += time - started
    started = time
    _resolve(light, paint, stride, width, height, background, out, x0, y0)
    time = clock_nanoseconds(clock) if clock >= 0 else 0
    statistics[BLEND] += time - started
