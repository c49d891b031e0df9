"""Programs in one arena, and rows that copy outputs of one to inputs of another.

The arenas lie one behind the other. A program's rows are followed by those that copy its outputs
on, so that one call of the interpreter runs as many of the programs as are due.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from itertools import accumulate
from typing import NamedTuple

import numpy as np

from nw_policies.executor.program import COPY, OFFSETS, WIDTH, Program, Rows, Slot


class Link(NamedTuple):
    """An output that becomes all of an input, or a part of it, when its program has run."""

    giver: int
    """Number of the program."""
    output: str
    taker: int
    """Number of the program."""
    input: str
    first: int = 0
    """Of the input's floats."""


@lru_cache(maxsize=4)  # All trials of a process run the same policies.
def joined(
    programs: tuple[Program, ...], links: tuple[Link, ...]
) -> tuple[Program, tuple[Rows, ...]]:
    """Return programs in one arena, checked, and the rows of each with its links behind them.

    Inputs and outputs are named by the number of their program: `0 rgb`.

    Raises:
        ValueError: an output lies within an input of its program, so that a link might change it
            before another has copied it; or all of them are too large together.
    """
    starts = list(accumulate((program.arena for program in programs), initial=0))
    numbers = np.zeros(starts[-1], np.float32)
    inputs, outputs = dict[str, Slot](), dict[str, Slot]()
    parts: list[Rows] = []
    for number, program in enumerate(programs):
        start = starts[number]
        numbers[start : start + program.numbers.size] = program.numbers
        for slots, own in ((inputs, program.inputs), (outputs, program.outputs)):
            for name, slot in own.items():
                slots[f"{number} {name}"] = replace(slot, offset=start + slot.offset)
        if any(
            one.offset < other.offset + other.size and other.offset < one.offset + one.size
            for one in program.outputs.values()
            for other in program.inputs.values()
        ):
            raise ValueError("an output is an input")
    for number, (program, start) in enumerate(zip(programs, starts, strict=False)):
        rows = [_copying(link, inputs, outputs) for link in links if link.giver == number]
        carried = np.array(rows, np.int64).reshape(-1, WIDTH)
        parts.append(np.concatenate([moved(program.rows, start), carried]))
    fixed = [moved(program.once, start) for program, start in zip(programs, starts, strict=False)]
    program = Program(
        arena=starts[-1],
        scratch=programs[0].scratch,
        once=np.concatenate(fixed),
        rows=np.concatenate(parts),
        numbers=numbers,
        inputs=inputs,
        outputs=outputs,
    )
    program.check()
    return program, tuple(parts)


def moved(rows: Rows, by: int) -> Rows:
    """Return rows that do in floats `by` later what rows (n, WIDTH) do."""
    shifted = rows.copy()
    for operation, fields in enumerate(OFFSETS):
        for field in fields:
            shifted[rows[:, 0] == operation, field] += by
    return shifted


def _copying(link: Link, inputs: dict[str, Slot], outputs: dict[str, Slot]) -> list[int]:
    """Return the row that copies an output."""
    given = outputs[f"{link.giver} {link.output}"]
    taken = inputs[f"{link.taker} {link.input}"]
    if link.first < 0 or link.first + given.size > taken.size:
        raise ValueError(f"{given.size} numbers from {link.first} on, of {taken.size}")
    line = [1, 1, 1, given.size, 0, 0, 0, 1, 0, 0, 0, 1]
    row = [COPY, 0, *line, given.offset, taken.offset + link.first]
    return [*row, *[0] * (WIDTH - len(row))]
