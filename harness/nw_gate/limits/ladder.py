"""A ladder: a row of scenes from easy to hard, each with a number."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import NamedTuple

import numpy as np

from nw_base.errors import UsageError

_MOST_RUNGS = 100


class LimitTrial(NamedTuple):
    """A trial that is asked for; its result must be the same whenever and wherever it is run."""

    rung: int
    """Index of its rung, from the easiest."""
    number: int
    """Which of that rung's trials it is, from 0: start or seed follow from it."""


@dataclass(frozen=True, kw_only=True)
class Ladder:
    """What the rungs of a ladder are.

    Attributes:
        name: of what is measured, such as `bar height`.
        rungs: values from the easiest rung to the hardest, rising or falling, in SI units.
        unit: of the values, such as `m`; empty for a number without one.

    Raises:
        UsageError: the values are no ladder.
    """

    name: str
    rungs: tuple[float, ...]
    unit: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "rungs", tuple(float(value) for value in self.rungs))
        if not 2 <= len(self.rungs) <= _MOST_RUNGS:
            raise UsageError(
                f"ladder {self.name!r} has {len(self.rungs)} rungs",
                fix=f"give 2 to {_MOST_RUNGS} values",
            )
        steps = np.diff(np.array(self.rungs, float))
        if not all(map(isfinite, self.rungs)) or not ((steps > 0).all() or (steps < 0).all()):
            raise UsageError(
                f"rungs of ladder {self.name!r} neither rise nor fall: {list(self.rungs)}",
                fix="list finite values from the easiest rung to the hardest, each once",
            )

    @property
    def rises(self) -> bool:
        """Whether harder rungs have larger values."""
        return self.rungs[1] > self.rungs[0]

    @property
    def hardness(self) -> tuple[float, ...]:
        """The values with a sign that makes harder ones larger."""
        sign = 1.0 if self.rises else -1.0
        return tuple(sign * value for value in self.rungs)

    def says(self, value: float) -> str:
        """Return a value with its unit, such as `0.34 m`."""
        return f"{value:.6g} {self.unit}".rstrip()


def check_share(share: float) -> None:
    """Raise UsageError for a share that is not between 0 and 1."""
    if not 0.0 < share < 1.0:
        raise UsageError(
            f"share {share:g} is not between 0 and 1", fix="give 0.5 for half of the trials"
        )


def check_confidence(confidence: float) -> None:
    """Raise UsageError for a confidence that is not from 0.5 to 1."""
    if not 0.5 <= confidence < 1.0:
        raise UsageError(
            f"confidence {confidence:g} is not from 0.5 to 1", fix="give 0.95 for 95 %"
        )


def check_most(most: int) -> None:
    """Raise UsageError for a number of trials that is below 1."""
    if most < 1:
        raise UsageError(f"most {most} is not a number of trials", fix="give 1 or more")
