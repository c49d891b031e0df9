"""Programs: a network's computation as rows of whole numbers over one arena of float32.

A program is data. `check` shows of each row that it reads and writes inside the arena, so that a
program that an untrusted file was planned into may run anywhere: it computes numbers from numbers,
in time and memory that are known beforehand.

The fields of a row are listed in `_FIELDS`; offsets, strides and sizes count floats.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

VERSION = 1
"""Changes whenever a program's outputs may change in a bit: "nw-eval networks 1"."""
IDENTITY = f"nw-eval networks {VERSION}"
"""What results are of that were computed by programs: one kind on every processor."""

(
    PRODUCT, PACK, ELEMENTS, UNARY, COPY, NORM, SOFTMAX, REDUCE, SELECT, POOL, SCALED,
) = range(11)  # fmt: skip
ADD, SUB, MUL, DIV, MAX, MIN, LESS, EQUAL = range(8)
(
    RELU, LEAKY, ELU, TANH, SIGMOID, EXP, LOG, SQRT, NEG, ABS, ERF, SOFTPLUS, FLOOR, CEIL, ROUND,
    SIGN, SIN, COS,
) = range(18)  # fmt: skip

WIDTH = 26
PANEL = 16
"""Columns of a product that lie together in packed weights; lanes of all other operations."""
SLACK = 64
"""Floats behind each array that are read, and never used, as lanes beyond its end."""
DTYPES = ("<f4", "|u1", "|i1", "<i4", "<i8", "|b1")
"""Types that an input may be given as."""
MOST_FLOATS = 2**26
"""Of an arena: 256 MiB."""
MOST_ROWS = 100_000
MOST_WORK = 10**10
"""Elements that one run may touch: some seconds, where policies take a millisecond."""

Floats = NDArray[np.float32]
Rows = NDArray[np.int64]
Extent = tuple[int, int]
"""A length, and a stride."""


@dataclass(frozen=True)
class Slot:
    """Where an input or output lies, without gaps."""

    offset: int
    shape: tuple[int, ...]
    dtype: str = "<f4"
    """What an input is given as; in the arena it is float32, and so are outputs."""

    @property
    def size(self) -> int:
        """How many floats it has."""
        return math.prod(self.shape)

    def listed(self) -> list[Any]:
        """Return it as JSON has it, for `of`."""
        return [self.offset, self.shape, self.dtype]

    @classmethod
    def of(cls, offset: Any, shape: Any, dtype: Any) -> Slot:
        """Return what `listed` gave.

        Raises:
            ValueError, TypeError: it is something else.
        """
        if dtype not in DTYPES:
            raise ValueError(f"numbers of type {dtype!r}")
        return cls(int(offset), tuple(int(side) for side in shape), dtype)


@dataclass(frozen=True, kw_only=True, eq=False)
class Program:
    """A planned network.

    Attributes:
        arena: how many floats it needs.
        scratch: offset of floats that kernels use between two steps.
        once: (n, WIDTH), rows that depend on no input: run in this order before the first call.
        rows: (n, WIDTH), run in this order at each call.
        numbers: what the arena holds before the first call, from its offset 0 on: weights, packed.
        inputs: by name.
        outputs: by name.
    """

    arena: int
    scratch: int
    once: Rows
    rows: Rows
    numbers: Floats
    inputs: Mapping[str, Slot]
    outputs: Mapping[str, Slot]

    def packed(self) -> bytes:
        """Return the program as bytes, for `unpacked`."""
        header = {
            "version": VERSION,
            "arena": self.arena,
            "scratch": self.scratch,
            "rows": [len(self.once), len(self.rows)],
            "numbers": self.numbers.size,
            "inputs": [[name, *slot.listed()] for name, slot in self.inputs.items()],
            "outputs": [[name, *slot.listed()] for name, slot in self.outputs.items()],
        }
        text = json.dumps(header).encode()
        rows = [each.astype("<i8").tobytes() for each in (self.once, self.rows)]
        numbers = self.numbers.astype("<f4").tobytes()
        return b"".join([len(text).to_bytes(4, "little"), text, *rows, numbers])

    @classmethod
    def unpacked(cls, data: bytes) -> Program:
        """Return a checked program from bytes, whoever wrote them.

        Raises:
            ValueError: they are no program, or one that `check` refuses.
        """
        start = 4 + int.from_bytes(data[:4], "little")
        try:
            header: dict[str, Any] = json.loads(data[4:start])
            if header["version"] != VERSION:
                raise ValueError(f"it is of version {header['version']}, not {VERSION}")
            once, count = (int(number) for number in header["rows"])
            rows = np.frombuffer(data, "<i8", (once + count) * WIDTH, start).reshape(-1, WIDTH)
            numbers = np.frombuffer(data, "<f4", int(header["numbers"]), start + rows.nbytes)
            slots = [
                {str(name): Slot.of(*rest) for name, *rest in header[kind]}
                for kind in ("inputs", "outputs")
            ]
            program = cls(
                arena=int(header["arena"]),
                scratch=int(header["scratch"]),
                once=rows[:once].astype(np.int64),
                rows=rows[once:].astype(np.int64),
                numbers=numbers.astype(np.float32),
                inputs=slots[0],
                outputs=slots[1],
            )
        except (KeyError, TypeError, RecursionError, UnicodeDecodeError) as error:
            raise ValueError(f"no program: {error!r}") from None
        program.check()
        return program

    def check(self) -> None:
        """Check that running it touches nothing outside its arena, and ends.

        Raises:
            ValueError: it may; says which row.
        """
        if not 2 * SLACK <= self.arena <= MOST_FLOATS or self.numbers.size > self.arena:
            raise ValueError(f"an arena of {self.arena} floats for {self.numbers.size} numbers")
        every = [*self.once.tolist(), *self.rows.tolist()]
        if len(every) > MOST_ROWS:
            raise ValueError(f"it has {len(every)} rows, over {MOST_ROWS}")
        end = self.arena - SLACK
        for name, slot in (*self.inputs.items(), *self.outputs.items()):
            if slot.offset < 0 or min(slot.shape, default=1) < 0 or slot.offset + slot.size > end:
                raise ValueError(f"{name!r} lies outside of the arena")
        if not 0 <= self.scratch <= end:
            raise ValueError("its scratch lies outside of the arena")
        work = 0
        for number, row in enumerate(every):
            try:
                work += _inside(row, end)
            except LookupError:
                raise ValueError(f"row {number}: no such operation") from None
            except ValueError as error:
                raise ValueError(f"row {number}: {error}") from None
        if work > MOST_WORK:
            raise ValueError(f"one run touches {work} floats, over {MOST_WORK}")


def _inside(row: list[int], end: int) -> int:
    """Return how many floats a row touches, all of them below `end`.

    Raises:
        LookupError: it is of no known operation.
        ValueError: it touches others.
    """
    work = 0
    for offset, extents in touched(row):
        low = high = offset
        elements = 1
        for length, stride in extents:
            if not 0 <= length <= end or abs(stride) > end:
                raise ValueError(f"a length of {length} with stride {stride}, of {end} floats")
            reach = max(length - 1, 0) * stride
            low, high = low + min(reach, 0), high + max(reach, 0)
            elements *= length
        work += elements
        if low < 0 or high >= end:
            raise ValueError(f"floats {low} to {high} of {end}")
    return work


Touched = Iterator[tuple[int, list[Extent]]]
"""Offsets, and the extents by which a row goes on from each."""


def touched(q: list[int]) -> Touched:
    """Give all that a row reads and writes.

    Raises:
        LookupError: it is of no known operation.
    """
    yield from _ROWS[q[0]](q) if 0 <= q[0] < len(_ROWS) else _unknown()


def _unknown() -> Touched:
    raise LookupError


def _panels(columns: int) -> int:
    return -(-columns // PANEL)


def _product(q: list[int]) -> Touched:
    x, xs, n1, s1, n2, s2, n3, w, b, columns, y, ys, rows, _, times, x_step, y_step, w_step = q[
        1:19
    ]
    depth, panels = n1 * n2 * n3, _panels(columns)
    yield x, [(times, x_step), (rows, xs), (n1, s1), (n2, s2), (n3, 1)]
    yield w, [(times, w_step), (panels * depth * PANEL, 1)]
    # The depth of all rows and panels is the work.
    yield b, [(panels * PANEL, 1)]
    yield b, [(times, 0), (rows, 0), (depth, 0), (panels * PANEL, 1)]
    yield y, [(times, y_step), (rows, ys), (columns, 1)]


def _pack(q: list[int]) -> Touched:
    source, deep, across, depth, columns, target, times, step, to_step = q[1:10]
    yield source, [(times, step), (depth, deep), (columns, across)]
    yield target, [(times, to_step), (_panels(columns) * depth * PANEL, 1)]


def _four(sizes: list[int], strides: list[int]) -> list[Extent]:
    return list(zip(sizes, strides, strict=True))


def _elements(q: list[int]) -> Touched:
    if not ADD <= q[1] <= EQUAL:
        raise LookupError
    sizes = q[2:6]
    for offset, strides in ((q[18], q[6:10]), (q[19], q[10:14]), (q[20], q[14:18])):
        yield offset, _four(sizes, strides)


def _scaled(q: list[int]) -> Touched:
    if not ADD <= q[21] <= EQUAL or (q[9], q[17]) != (1, 1) or q[13] not in {0, 1}:
        raise LookupError
    yield from _elements(q)
    yield q[22], []


def _select(q: list[int]) -> Touched:
    sizes = q[2:6]
    for number in range(4):
        yield q[22 + number], _four(sizes, q[6 + 4 * number : 10 + 4 * number])


def _unary(q: list[int]) -> Touched:
    if not RELU <= q[1] <= COS:
        raise LookupError
    yield q[2], [(q[4], 1)]
    yield q[3], [(q[4], 1)]
    yield q[5], []


def _copy(q: list[int]) -> Touched:
    yield q[14], _four(q[2:6], q[6:10])
    yield q[15], _four(q[2:6], q[10:14])


def _norm(q: list[int]) -> Touched:
    x, rows, n, gamma, beta, numbers, y = q[1:8]
    for offset in (x, y):
        yield offset, [(rows, n), (n, 1)]
    for offset, count in ((gamma, n), (beta, n), (numbers, 2)):
        yield offset, [(count, 1)]


def _softmax(q: list[int]) -> Touched:
    x, rows, n, y = q[1:5]
    for offset in (x, y):
        yield offset, [(rows, n), (n, 1)]


def _reduce(q: list[int]) -> Touched:
    f, x, rows, n, y = q[1:6]
    if f not in {ADD, MUL, MAX, MIN}:
        raise LookupError
    yield x, [(rows, n), (max(n, 1), 1)]
    yield y, [(rows, 1)]


def _pool(q: list[int]) -> Touched:
    if q[1] not in {ADD, MAX}:
        raise LookupError
    outer = q[2:5]
    yield q[15], [*zip(outer, q[7:10], strict=True), (max(q[5], 1), q[10]), (max(q[6], 1), q[11])]
    yield q[16], list(zip(outer, q[12:15], strict=True))


_ROWS = (
    _product, _pack, _elements, _unary, _copy, _norm, _softmax, _reduce, _select, _pool,
    _scaled,
)  # fmt: skip
"""By operation, as they are numbered above."""
OFFSETS = (
    (1, 8, 9, 11), (1, 6), (18, 19, 20), (2, 3, 5), (14, 15), (1, 4, 5, 6, 7), (1, 4), (2, 5),
    (22, 23, 24, 25), (15, 16), (18, 19, 20, 22),
)  # fmt: skip
"""Fields of a row that are offsets in the arena, by operation."""
