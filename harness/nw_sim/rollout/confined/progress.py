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
_TIMES = slice(11, 15)
"""Fields of /proc/PID/stat behind the name: utime, stime, cutime and cstime."""


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
    """Return the fields of /proc/PID/stat behind the name, which may hold anything; [] = gone."""
    with suppress(OSError):
        return text_of(f"/proc/{process}/stat").rpartition(")")[2].split()
    return []


def descendants(process: int) -> list[int]:
    """Return what a process, or any of its threads, started, and what that did.

    Whatever session it is in; but what has lost its parent is not among it.
    """
    pids: list[int] = []
    for each in _children(process):
        pids += [each, *descendants(each)]
    return pids


def _children(process: int) -> list[int]:
    children: list[int] = []
    with suppress(OSError):  # It has ended.
        for thread in os.listdir(f"/proc/{process}/task"):  # noqa: PTH208 - Path takes tenfold.
            children += map(int, text_of(f"/proc/{process}/task/{thread}/children").split())
    return children


class Progress:
    """How processes and their children get on since their last step.

    Args:
        *processes: their numbers.
        waits: whether they may wait for others, such as a server: only a signal stops them then.
    """

    def __init__(self, *processes: int, waits: bool = False) -> None:
        self._processes = processes
        self._waits = waits
        self._ticks = [0] * len(processes)
        self._looked = monotonic()
        self.steps()

    def steps(self) -> None:
        """Count from now: they have come to their next step."""
        self.idle = self._stopped = self._waited = 0.0
        self._spent = [0.0] * len(self._processes)

    def look(self) -> str:
        """Look about once a second; return why they will do nothing more, empty = they may."""
        now = monotonic()
        if now - self._looked >= _BETWEEN:
            # Whoever looks may have been stopped itself, and they with it.
            passed = min(now - self._looked, 2.0 * _BETWEEN)
            before, self._ticks = self._ticks, [_ticks(each) for each in self._processes]
            is_stopped = any(stat_of(each)[:1] == ["T"] for each in self._processes)
            self._looked = now
            self.idle = self.idle + passed if self._ticks == before else 0.0
            self._stopped = self._stopped + passed if is_stopped else 0.0
            self._waited += passed
            for index, (old, new) in enumerate(zip(before, self._ticks, strict=True)):
                self._spent[index] += max(0, new - old) / os.sysconf("SC_CLK_TCK")
        if self._stopped >= HANGS_AFTER:
            return f"a signal stopped its process {HANGS_AFTER:g} s ago; find out who sent it"
        if self.idle >= HANGS_AFTER and not self._waits:
            return f"its processes used no processor time for {HANGS_AFTER:g} s"
        return ""

    def busy(self, first: int = 0) -> float:
        """Return the most seconds of processor time that one has used, from the `first` on.

        Four cores that are busy for ten seconds are so for ten seconds.
        """
        return min(max(self._spent[first:], default=0.0), self._waited)


def _ticks(process: int) -> int:
    """Return the processor time of a process, its children and those that it has waited for."""
    family = (process, *descendants(process))
    return sum(int(field) for each in family for field in stat_of(each)[_TIMES])
