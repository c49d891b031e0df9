"""What every interval of this room is given as."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple


class Interval(NamedTuple):
    """A confidence interval, both ends within the range of what it speaks of."""

    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """A mean with its interval and the number of observations behind it."""

    mean: float
    interval: Interval
    n: int
    confidence: float


def check_confidence(confidence: float) -> None:
    """Raise ValueError for a confidence that is no probability, such as 95."""
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence {confidence} is not between 0 and 1; write 0.95 for 95 %")
