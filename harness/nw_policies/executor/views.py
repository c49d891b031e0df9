"""Views: which floats of the arena an array has, by offset, shape and strides."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from nw_policies.executor.graph import UnsupportedError

Shape = tuple[int, ...]
Kind = Literal["float", "bool", "whole"]
AXES = 4
"""Axes of a row; those of size 1 are left out, and those that lie in a row become one."""


@dataclass(frozen=True)
class View:
    """Floats in the arena: element (i, j, ...) lies at offset + i * strides[0] + ..."""

    offset: int
    shape: Shape
    strides: Shape
    is_fixed: bool = False
    """Whether it depends on no input."""
    kind: Kind = "float"
    """What the floats stand for: booleans are 0 and 1, whole numbers those below 2**24."""

    @property
    def size(self) -> int:
        """How many elements it has."""
        return math.prod(self.shape)

    @property
    def is_dense(self) -> bool:
        """Whether its elements lie one behind the other."""
        dense = strides_of(self.shape)
        return all(
            n == 1 or s == t for n, s, t in zip(self.shape, self.strides, dense, strict=True)
        )

    def transposed(self, order: Sequence[int]) -> View:
        """Return it with its axes in another order."""
        shape = tuple(self.shape[axis] for axis in order)
        return replace(self, shape=shape, strides=tuple(self.strides[axis] for axis in order))

    def broadcast(self, shape: Shape) -> View:
        """Return it repeated to a shape; raises ValueError if it does not broadcast to it."""
        lead = len(shape) - len(self.shape)
        if lead < 0 or any(n not in {1, m} for n, m in zip(self.shape, shape[lead:], strict=True)):
            raise ValueError(f"{self.shape} does not broadcast to {shape}")
        strides = tuple(
            0 if n == 1 and m != 1 else s
            for n, s, m in zip(self.shape, self.strides, shape[lead:], strict=True)
        )
        return replace(self, shape=shape, strides=(0,) * lead + strides)

    def reshaped(self, shape: Shape) -> View | None:
        """Return it with another shape of as many elements; None where they must be copied."""
        if self.is_dense:
            return replace(self, shape=shape, strides=strides_of(shape))
        runs: list[tuple[int, int]] = []
        for n, s in zip(self.shape, self.strides, strict=True):
            if n == 1:
                continue
            if runs and runs[-1][1] == n * s:
                runs[-1] = (runs[-1][0] * n, s)
            else:
                runs.append((n, s))
        strides: list[int] = []
        for wanted in shape:  # Each run is split from its slow end.
            if wanted == 1:
                strides.append(0)
                continue
            if not runs or wanted == 0 or runs[0][0] % wanted:
                return None
            n, s = runs.pop(0)
            strides.append(n // wanted * s)
            if n > wanted:
                runs.insert(0, (n // wanted, s))
        return None if runs else replace(self, shape=shape, strides=tuple(strides))


def strides_of(shape: Shape) -> Shape:
    """Return the strides of an array without gaps."""
    strides: list[int] = []
    step = 1
    for n in reversed(shape):
        strides.append(step)
        step *= n
    return tuple(reversed(strides))


def merged(shape: Shape, *strides: Shape) -> tuple[list[int], list[list[int]]]:
    """Return four sizes, and as many strides for each array, that go over the same elements.

    Raises:
        UnsupportedError: four are too few.
    """
    runs: list[tuple[int, list[int]]] = []
    for axis, n in enumerate(shape):
        if n == 1:
            continue
        steps = [each[axis] for each in strides]
        if runs and all(o == n * s for o, s in zip(runs[-1][1], steps, strict=True)):
            runs[-1] = (runs[-1][0] * n, steps)
        else:
            runs.append((n, steps))
    if len(runs) > AXES:
        raise UnsupportedError(f"arrays of more than {AXES} axes that are not in a row")
    runs = [(1, [0] * len(strides))] * (AXES - len(runs)) + runs
    if runs[-1][0] == 1:
        runs[-1] = (1, [1] * len(strides))
    return [n for n, _ in runs], [[steps[k] for _, steps in runs] for k in range(len(strides))]
