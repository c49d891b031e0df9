"""Networks that run: a program in its arena, with arrays for what goes in and comes out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_policies.executor.kernels import run
from nw_policies.executor.program import Floats, Program, Rows, Slot


class Network:
    """A program that was checked, with its memory.

    Example:
        >>> network = Network(plan(graph))
        >>> network({"obs": observation})["action"]
    """

    def __init__(self, program: Program) -> None:
        """Lay the program's numbers out.

        Args:
            program: from `plan` or `Program.unpacked`, which have checked it.
        """
        self._arena = np.zeros(program.arena, np.float32)
        self._arena[: program.numbers.size] = program.numbers
        run(self._arena, np.ascontiguousarray(program.once), program.scratch)
        self._rows = np.ascontiguousarray(program.rows)
        self._scratch = program.scratch
        self.inputs = {name: self._array(slot) for name, slot in program.inputs.items()}
        self.outputs = {name: self._array(slot) for name, slot in program.outputs.items()}

    def _array(self, slot: Slot) -> Floats:
        return self._arena[slot.offset : slot.offset + slot.size].reshape(slot.shape)

    def __call__(self, feeds: Mapping[str, NDArray[Any]]) -> dict[str, Floats]:
        """Run it once.

        Args:
            feeds: each input by name; other types than float32 are converted.

        Returns:
            Each output by name, a view of memory that the next call overwrites.

        Raises:
            ValueError: an input has another shape.
        """
        for name, array in self.inputs.items():
            given = feeds[name]
            if given.shape != array.shape:
                raise ValueError(f"`{name}` has the shape {given.shape}, not {array.shape}")
            array[...] = given
        self.run(self._rows)
        return self.outputs

    def run(self, rows: Rows) -> None:
        """Run some of the program's rows on what its inputs hold.

        Args:
            rows: (n, WIDTH), in one piece of memory.
        """
        run(self._arena, rows, self._scratch)
