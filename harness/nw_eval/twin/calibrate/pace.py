"""How far a piece of work is, and how long the rest will take."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

Say = Callable[[str], None]

_EVERY = 5.0
"""Seconds between two lines."""


@dataclass
class Pace:
    """Says now and then how much is done.

    Attributes:
        say: is given each line.
        what: is done, e.g. `features of photographs`.
        total: pieces of it; 0 where they cannot be counted.
        clock: seconds, from any beginning.
        begun_at: pieces that were done before, in unknown time.
    """

    say: Say
    what: str
    total: int
    clock: Callable[[], float] = time.monotonic
    begun_at: int = 0
    _begin: float = field(init=False)
    _last: float = field(init=False)

    def __post_init__(self) -> None:
        """Begin to count."""
        self._begin = self._last = self.clock()

    def at(self, done: int) -> None:
        """Say that so many are done, if the last line is some seconds old, or all are."""
        now = self.clock()
        spent = now - self._begin
        if done >= self.total:
            self.say(f"{self.what}: {self.total} in {_duration(spent)}")
        elif done > self.begun_at and now - self._last >= _EVERY:
            left = spent / (done - self.begun_at) * (self.total - done)
            self.say(f"{self.what}: {done} of {self.total}, about {_duration(left)} left")
            self._last = now

    def goes_on(self) -> None:
        """Say for how long the work goes on, if the last line is some seconds old."""
        now = self.clock()
        if now - self._last >= _EVERY:
            self.say(f"{self.what}: {_duration(now - self._begin)} so far")
            self._last = now


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min"
