"""Rows of a finished plan that become one: fewer walks over large arrays, with the same bits.

* A number combined with an array, whose result one other element-wise row alone takes, is computed
  there: `x / 255 - mean` is one row.
* An array that is only copied, as into the borders of a convolution, is written there at once.

Memory is given out once, so nothing but the rows that touch an array can know it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from nw_policies.executor import program as rows
from nw_policies.executor.views import merged

Row = list[int]

_LARGE = 1024
"""Elements from which on a row more is noticed."""


def fused(program: Sequence[tuple[Row, bool]], kept: Sequence[int]) -> list[tuple[Row, bool]]:
    """Return the rows of a plan, some of them as one.

    Args:
        program: rows of `rows.WIDTH` fields, and whether each depends on no input.
        kept: offsets of arrays that are wanted as they are: the outputs.
    """
    done = list(program)
    at = 0
    while at + 1 < len(done):
        (first, is_fixed), (second, other) = done[at : at + 2]
        one = None
        if is_fixed == other and first[0] in {rows.ELEMENTS, rows.SCALED} and _is_line(first):
            start, end = first[20], first[20] + first[5]
            others = [row for row, _ in (*done[:at], *done[at + 2 :])]
            is_alone = not any(start <= place < end for place in kept)
            if is_alone and not any(_touches(row, start, end) for row in others):
                one = _scaled(first, second) or _written(first, second)
        if one is None:
            at += 1
        else:
            done[at : at + 2] = [(one, is_fixed)]
    return done


def _is_line(row: Row) -> bool:
    """Whether a row makes a large array without gaps."""
    return row[2:5] == [1, 1, 1] and row[5] >= _LARGE and row[17] == 1


def _scaled(first: Row, second: Row) -> Row | None:
    """Return g(f(x, number), y) for f(x, number) and g(that, y)."""
    if (first[0], second[0]) != (rows.ELEMENTS, rows.ELEMENTS) or not _is_line(second):
        return None
    if second[18] != first[20] or second[5] != first[5]:
        return None
    if first[20] <= second[19] < first[20] + first[5]:  # It is y, too.
        return None
    if (first[9], first[13], second[9]) != (1, 0, 1) or second[13] not in {0, 1}:
        return None
    one = second.copy()
    one[0], one[18] = rows.SCALED, first[18]
    one[21:23] = first[1], first[19]
    return one


def _written(first: Row, second: Row) -> Row | None:
    """Return a row that writes where the second one copies its result."""
    if second[0] != rows.COPY or second[14] != first[20]:
        return None
    sizes, source, target = second[2:6], second[6:10], second[10:14]
    step, elements = 1, []
    for size in reversed(sizes):
        elements.append(0 if size == 1 else step)
        step *= size
    same = all(n == 1 or s == e for n, s, e in zip(sizes, source, elements[::-1], strict=True))
    if not same or step != first[5] or target[3] != 1:
        return None
    steps = [tuple(first[last] * each for each in elements[::-1]) for last in (9, 13)]
    new, strides = merged(tuple(sizes), *steps, tuple(target))
    one = first.copy()
    one[2:18] = [*new, *(each for line in strides for each in line)]
    one[20] = second[15]
    return one


def _touches(row: Row, start: int, end: int) -> bool:
    """Whether a row may read or write any of some floats."""
    for offset, extents in rows.touched(row):
        reaches: list[Any] = [max(n - 1, 0) * stride for n, stride in extents]
        low = offset + sum(min(reach, 0) for reach in reaches)
        high = offset + sum(max(reach, 0) for reach in reaches)
        if low < end and high >= start:
            return True
    return False
