"""How long what is counted still takes, from how fast the last of it ended."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

_WINDOW = 60.0
"""Seconds whose ends give the rate: results from the cache, which come at once, drop out of it."""
_LEAST = 8
"""Ends that give the rate where fewer came within these seconds."""
_MOST = 4096


class TimeLeft:
    """Estimates the seconds that are left, anew whenever it is asked.

    Between two ends the estimate falls with the clock. It grows once the next end is overdue.

    Args:
        clock: seconds, never going back.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._ends: deque[float] = deque([clock()], maxlen=_MOST)

    def restart(self) -> None:
        """Forget all ends: something else is counted from now on."""
        self._ends = deque([self._clock()], maxlen=_MOST)

    def ended(self) -> None:
        """Take that one more has ended."""
        self._ends.append(self._clock())

    def seconds(self, left: int) -> float | None:
        """Return about how many seconds the rest takes; None if nothing has ended yet.

        Args:
            left: how many have not ended.
        """
        if len(self._ends) < 2 or left < 1:
            return None
        now, last = self._clock(), self._ends[-1]
        recent = sum(end >= now - _WINDOW for end in self._ends)
        ends = list(self._ends)[-max(recent, _LEAST) :]
        first, count = ends[0], len(ends) - 1
        steady = left * (last - first) / count - (now - last)
        overdue = (left - 1) * (now - first) / (count + 1)
        return max(steady, overdue, 0.0)

    def in_words(self, left: int) -> str:
        """Return such as `about 3 min left`; nothing where that is unknown."""
        seconds = self.seconds(left)
        return "" if seconds is None else f"about {duration(seconds)} left"


def duration(seconds: float) -> str:
    """Return a time in two digits, such as `40 s`, `3 min` or `1.5 h`."""
    if seconds < 99.5:
        return f"{max(1.0, seconds):.0f} s"
    minutes = seconds / 60.0
    return f"{minutes:.0f} min" if minutes < 99.5 else f"{minutes / 60.0:.1f} h"
