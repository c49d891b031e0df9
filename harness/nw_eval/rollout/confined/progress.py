"""Whether processes get on, by their processor time: how what hangs is told from what is slow.

A process that waits for ever, or that somebody has stopped, uses no processor time. One that loops
uses it without an end. An honest one on a machine with twenty others uses little in a minute, but
some, and comes to its next step.

Sources: proc(5), `stat` and `children`.
"""

from __future__ import annotations

import os
from contextlib import suppress
from time import monotonic

HANGS_AFTER = 45.0
"""Seconds without processor time, or of processor time without a step."""

_BETWEEN = 1.0
"""Seconds between two looks, which cost 0.1 ms."""
_FIRST_TIME, _PAST_TIMES = 11, 15
"""Fields of /proc/PID/stat behind the name: utime, and the one behind cstime."""


def text_of(path: str) -> str:
    """Return a file of /proc: some are read ten times a second, so without a buffered stream.

    Raises:
        OSError: the process has ended, or hides it.
    """
    file = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        content = b""
        while piece := os.read(file, 1 << 16):
            content += piece
        return content.decode(errors="replace")
    finally:
        os.close(file)


def stat_of(process: int) -> list[str]:
    """Return the fields of /proc/PID/stat behind the name, which may hold anything.

    Raises:
        OSError: as `text_of`.
    """
    return text_of(f"/proc/{process}/stat").rpartition(")")[2].split()


def descendants(process: int) -> list[int]:
    """Return what a process, or any of its threads, started, and what that did.

    Whatever session it is in; but what has lost its parent is not among it.
    """
    found: list[int] = []
    for each in _children(process):
        found += [each, *descendants(each)]
    return found


def _children(process: int) -> list[int]:
    found: list[int] = []
    with suppress(OSError):  # It has ended.
        for thread in os.listdir(f"/proc/{process}/task"):  # noqa: PTH208 - Path takes tenfold.
            found += map(int, text_of(f"/proc/{process}/task/{thread}/children").split())
    return found


class Progress:
    """How a process and its children get on since its last step.

    Args:
        process: its number.

    Attributes:
        idle: seconds without processor time, at the end of those that are looked at.
        stopped: seconds for which a signal has stopped the process, as above.
        busy: seconds of processor time without a step, of one core or several.
    """

    def __init__(self, process: int) -> None:
        self._process = process
        self._ticks = 0
        self._looked = monotonic()
        self.steps()

    def steps(self) -> None:
        """Count from now: it has come to its next step."""
        self.idle = self.stopped = self._waited = self._spent = 0.0

    @property
    def busy(self) -> float:
        """See the class; four cores that are busy for ten seconds are so for ten seconds."""
        return min(self._spent, self._waited)

    def look(self) -> None:
        """Take in what it has done since the last look, about once a second."""
        now = monotonic()
        if now - self._looked < _BETWEEN:
            return
        # Whoever looks may have been stopped itself, and the process with it.
        passed = min(now - self._looked, 2.0 * _BETWEEN)
        self._looked = now
        ticks = _ticks(self._process)
        self.idle = self.idle + passed if ticks == self._ticks else 0.0
        self.stopped = self.stopped + passed if _is_stopped(self._process) else 0.0
        self._waited += passed
        self._spent += max(0, ticks - self._ticks) / os.sysconf("SC_CLK_TCK")
        self._ticks = ticks


def _is_stopped(process: int) -> bool:
    with suppress(OSError, IndexError):
        return stat_of(process)[0] == "T"
    return False


def _ticks(process: int) -> int:
    """Return the processor time of a process, its children and those that it has waited for."""
    total = 0
    for each in (process, *descendants(process)):
        with suppress(OSError, ValueError, IndexError):  # It has ended, or hides it.
            total += sum(map(int, stat_of(each)[_FIRST_TIME:_PAST_TIMES]))
    return total
