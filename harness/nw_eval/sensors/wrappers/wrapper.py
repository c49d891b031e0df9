"""What a wrapper is: something that turns a sample into another one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from nw_eval.memory import Arrays, Forgetful, Memory
from nw_eval.sensors.sensor import Moment

Sample = NDArray[Any]


@dataclass(frozen=True)
class Spec:
    """Shape and type of a sample."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]


@dataclass
class Shot:
    """What a wrapper may know beside the sample itself.

    Attributes:
        step: control steps done; 0 at the start of a trial.
        moment: world and progress; None while shapes are worked out, before there is a world.
    """

    step: int
    moment: Moment | None
    generator: Callable[[int], np.random.Generator]

    @property
    def time(self) -> float:
        """Seconds since the start of the trial."""
        return 0.0 if self.moment is None else self.moment.world.time

    @cached_property
    def rng(self) -> np.random.Generator:
        """Randomness of this sample alone: from the trial's seed, the wrapper's place and `step`.

        It depends on nothing that was drawn before, so a trial continued from its middle sees the
        same noise.
        """
        return self.generator(self.step)


class Wrapper(Memory[Arrays], Protocol):
    """A wrapper as the chain uses it; classes of plug-ins need `__call__` only."""

    def __call__(self, sample: Sample, shot: Shot) -> Sample:
        """Return the sample that comes out, in memory of its own or unchanged."""
        ...

    def reset(self, rng: np.random.Generator) -> None:
        """Begin a trial; `rng` is the same for all of it."""
        ...


class Plain(Forgetful):
    """A wrapper without memory."""

    def reset(self, rng: np.random.Generator) -> None:
        """Nothing to forget."""
