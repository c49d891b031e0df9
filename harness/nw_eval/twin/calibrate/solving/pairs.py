"""Which photographs are compared."""

from __future__ import annotations

_OVERLAP = 10
"""Neighbours on one side that each is compared with."""
_LOOP = 60
"""Photographs of a sequence, evenly spread, that are all compared with each other: what closes
loops. A shorter sequence is compared wholly."""


def pairs_of(count: int, *, in_sequence: bool) -> list[tuple[int, int]]:
    """Return pairs (i, j), i < j, sorted.

    Args:
        count: of photographs.
        in_sequence: whether neighbours in number are neighbours in space: then each is compared
            with the next ten and those 16, 32, ... further, and sixty of all with each other.
    """
    if not in_sequence or count <= _LOOP:
        return [(i, j) for i in range(count) for j in range(i + 1, count)]
    steps = [*range(1, _OVERLAP + 1), *(2**k for k in range(4, count.bit_length()))]
    spread = range(0, count, -(-count // _LOOP))
    found = {(i, i + step) for i in range(count) for step in steps if i + step < count}
    found |= {(i, j) for i in spread for j in spread if i < j}
    return sorted(found)
