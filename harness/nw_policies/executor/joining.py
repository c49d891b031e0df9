"""Programs that lie in one arena, and rows that carry what one of them gives to what another takes.

The arenas lie one behind the other. A program's rows are followed by those that copy its outputs
on, so that one call of the interpreter runs as many of the programs as are due.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import accumulate

import numpy as np

from nw_policies.executor.program import COPY, OFFSETS, WIDTH, Program, Rows, Slot


@dataclass(frozen=True)
class Link:
    """An output that becomes all of an input, or a part of it, when its program has run."""

    giver: int
    """Number of the program."""
    output: str
    taker: int
    """Number of the program."""
    input: str
    first: int = 0
    """Of the input's floats."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Joined:
    """Programs as one."""

    program: Program
    """Inputs and outputs are named by the number of their program: `0 rgb`."""
    parts: tuple[Rows, ...]
    """The rows of each program, with the links of its outputs behind them."""


@lru_cache(maxsize=4)  # All trials of a process run the same policies.
def joined(programs: tuple[Program, ...], links: tuple[Link, ...]) -> Joined:
    """Return programs in one arena, checked.

    Raises:
        ValueError: an output lies within an input of its program, so that a link might change it
            before another has copied it; or all of them are too large together.
    """
    starts = list(accumulate((program.arena for program in programs), initial=0))
    parts: list[Rows] = []
    for number, (program, start) in enumerate(zip(programs, starts[:-1], strict=True)):
        if any(
            one.offset < other.offset + other.size and other.offset < one.offset + one.size
            for one in program.outputs.values()
            for other in program.inputs.values()
        ):
            raise ValueError("an output is an input")
        rows = [
            _copying(program.outputs[link.output], start, programs[link.taker], starts, link)
            for link in links
            if link.giver == number
        ]
        carried = np.array(rows, np.int64).reshape(-1, WIDTH)
        parts.append(np.concatenate([moved(program.rows, start), carried]))
    numbers = np.zeros(starts[-1], np.float32)
    for program, start in zip(programs, starts[:-1], strict=True):
        numbers[start : start + program.numbers.size] = program.numbers
    pairs = list(enumerate(zip(programs, starts[:-1], strict=True)))
    program = Program(
        arena=starts[-1],
        scratch=programs[0].scratch,
        once=np.concatenate([moved(one.once, start) for _, (one, start) in pairs]),
        rows=np.concatenate(parts),
        numbers=numbers,
        inputs={f"{n} {k}": _moved(s, at) for n, (p, at) in pairs for k, s in p.inputs.items()},
        outputs={f"{n} {k}": _moved(s, at) for n, (p, at) in pairs for k, s in p.outputs.items()},
    )
    program.check()
    return Joined(program=program, parts=tuple(parts))


def moved(rows: Rows, by: int) -> Rows:
    """Return rows that do in floats `by` later what rows (n, WIDTH) do."""
    found = rows.copy()
    for operation, fields in enumerate(OFFSETS):
        for field in fields:
            found[rows[:, 0] == operation, field] += by
    return found


def _moved(slot: Slot, by: int) -> Slot:
    return replace(slot, offset=slot.offset + by)


def _copying(
    output: Slot, start: int, taker: Program, starts: Sequence[int], link: Link
) -> list[int]:
    """Return the row that copies an output of a program whose arena begins at `start`."""
    given = taker.inputs[link.input]
    if link.first < 0 or link.first + output.size > given.size:
        raise ValueError(f"{output.size} numbers from {link.first} on, of {given.size}")
    target = starts[link.taker] + given.offset + link.first
    line = [1, 1, 1, output.size, 0, 0, 0, 1, 0, 0, 0, 1]
    row = [COPY, 0, *line, start + output.offset, target]
    return [*row, *[0] * (WIDTH - len(row))]
