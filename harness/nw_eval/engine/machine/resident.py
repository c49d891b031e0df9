"""How much memory a worker and its children hold, and who ends first where there is none left.

Resident memory is what a machine runs out of. Pages that several processes share, such as libraries
and the map of a splat, count in parts: each process has its share of them (PSS), and the shares of
all workers together are what they take.

Sources: proc(5) and Linux's Documentation/filesystems/proc.rst for `statm`, `smaps_rollup`
and `oom_score_adj`; setrlimit(2) for RLIMIT_DATA.
"""

from __future__ import annotations

import resource
from contextlib import suppress
from pathlib import Path
from time import monotonic

from nw_eval.engine.machine.descendants import descendants, text_of

_PAGE = resource.getpagesize()
_SHARE_HOLDS = 1.0
"""Seconds for which it is taken as known what of the memory others have, too. To sum up the shares
of 700 MB takes the kernel 3 ms, in which the process cannot map memory; `statm` takes 5 us."""
_BETWEEN_LOOKS = 2**30
"""Bytes by which a process may go beyond its limit until somebody looks. Libraries reserve up to
280 MB that they never touch (`confinement.rules`)."""
_FIRST = b"1000"
"""Of the kernel's scale: whoever has it ends before all others."""


class Resident:
    """Watches the memory of processes and of those that they started.

    Args:
        *processes: their numbers.
    """

    def __init__(self, *processes: int) -> None:
        self._processes = processes
        self._of_others = 0
        self._known_until = 0.0

    def beyond(self, limit: int) -> int | None:
        """Return how many bytes they hold, if these are more than a limit.

        What they map is summed first, which is cheap and never too little. Shares are summed only
        where that is too much.
        """
        family = [each for own in self._processes for each in (own, *descendants(own))]
        mapped = sum(map(_mapped, family))
        now = monotonic()
        if mapped - (self._of_others if now < self._known_until else 0) <= limit:
            return None
        held = sum(map(_share, family))
        self._of_others, self._known_until = mapped - held, now + _SHARE_HOLDS
        return held if held > limit else None

    def restrain(self, limit: int | None) -> None:
        """Keep them from taking the whole machine between two looks.

        Where memory runs out the kernel ends them, and not whoever started them. And with a limit
        no process of them can reserve much more than that: it is refused, and Python says
        MemoryError.

        Args:
            limit: bytes that they may hold.
        """
        for process in self._processes:
            with suppress(OSError):
                Path(f"/proc/{process}/oom_score_adj").write_bytes(_FIRST)
            if limit is None:
                continue
            with suppress(OSError, ValueError):
                known = resource.prlimit(process, resource.RLIMIT_DATA)
                finite = (most for most in known if most != resource.RLIM_INFINITY)
                most = min([*finite, limit + _BETWEEN_LOOKS])
                resource.prlimit(process, resource.RLIMIT_DATA, (most, most))


def _mapped(process: int) -> int:
    """Return the bytes of memory that a process maps and that are there; 0 if it has ended."""
    with suppress(OSError, IndexError, ValueError):
        return int(text_of(f"/proc/{process}/statm").split()[1]) * _PAGE
    return 0


def _share(process: int) -> int:
    """Return a process's share of memory in bytes; what it maps, where it hides its share."""
    with suppress(OSError, IndexError, ValueError):
        kilobytes = text_of(f"/proc/{process}/smaps_rollup").partition("\nPss:")[2].split()[0]
        return int(kilobytes) * 1024
    return _mapped(process)
