"""Depth order, exactly: radix sort on all 32 bits of the depth.

Non-negative floats order like their bit patterns. Keys are int64: pattern less the smallest
pattern in the upper half, index in the lower. Least-significant-digit radix sort is stable, so
equal depths keep the order of the store. Sixteen-bit keys would cost 40 dB (measured).
"""

from __future__ import annotations

from typing import Any

from nw_eval.machine_code import inlined, kernel
from nw_eval.splat.kernels.math8 import bits_of
from nw_eval.splat.kernels.memory import peek, poke
from nw_eval.splat.kernels.project import DEPTH, RECORD

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
            here = peek(histogram, j)
            poke(histogram, j, total)
            total += here
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
