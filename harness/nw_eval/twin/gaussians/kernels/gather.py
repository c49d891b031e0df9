"""The records that touch one window, nearest first, in one stream."""

from __future__ import annotations

from typing import Any

from nw_eval.splat.kernels.math8 import bits_of, float_of
from nw_eval.splat.kernels.memory import load, peek, poke, store
from nw_eval.splat.kernels.project import COLUMNS, RECORD
from nw_eval.twin.gaussians.kernels.jit import kernel


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
    found = 0
    for i in range(count):
        number = peek(ordered, i) & 0xFFFFFFFF
        j = number * RECORD
        packed = int(bits_of(peek(records, j + COLUMNS)))
        first, last = packed & 0xFFFF, packed >> 16
        if first >= column1 or last < column0:
            continue
        first, last = max(first, column0) - column0, min(last, column1 - 1) - column0
        o = found * RECORD
        lower, upper = load(records, j), load(records, j + 8)
        store(out, o, lower)
        store(out, o + 8, upper)
        poke(out, o + COLUMNS, float_of(first | (last << 16)))
        poke(owners, found, number)
        found += 1
    return found


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
