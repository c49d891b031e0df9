"""How much of the machine a confined process may take."""

from __future__ import annotations

import math
import resource
from collections.abc import Generator
from contextlib import contextmanager, suppress

OPENING = 2**30
"""Bytes to open a small file in. Measured: libraries take 60 to 280 MB of it."""

_RUNNING = 2**31
"""Bytes to run trials in, without their scenes."""
_SCENE = 2**28
"""Bytes that a scene may take, with its rays and its physics."""
_SCENES = 32
"""Scenes that a process keeps at once."""
_COPIES = 8
"""Copies of a file that its reader may have at once: bytes, members, tensors, a graph's own."""


def memory_to_open(size: int) -> int:
    """Return how many bytes a process may hold that opens a file of `size` bytes."""
    return OPENING + _COPIES * size


def memory_to_run(size: int, *, scenes: int) -> int:
    """Return how many bytes a process may hold that runs such a file in scenes."""
    return _RUNNING + _SCENE * min(scenes, _SCENES) + _COPIES * size


def limit(*, memory: int | None, seconds: int | None) -> None:
    """Limit this process: no core dumps, so much memory of its own, so much processor time.

    Memory is what only this process has: heap, stacks, private maps. Address space would be the
    wrong measure, libraries reserve gigabytes of it.
    """
    _set(resource.RLIMIT_CORE, 0, 0)
    if memory is not None:
        _set(resource.RLIMIT_DATA, memory, memory)
    if seconds is not None:
        # SIGXCPU at the first limit says what happened; SIGKILL at the second would not.
        _set(resource.RLIMIT_CPU, seconds, seconds + 1)


@contextmanager
def processor_time(seconds: int) -> Generator[None]:
    """Let this process take so much more processor time inside the `with` block.

    Longer than that, and the system ends it with SIGXCPU, in the midst of native code too.
    """
    used = resource.getrusage(resource.RUSAGE_SELF)
    before, hard = resource.getrlimit(resource.RLIMIT_CPU)
    most = math.ceil(used.ru_utime + used.ru_stime) + seconds
    known = [limit for limit in (before, hard) if limit != resource.RLIM_INFINITY]
    _set(resource.RLIMIT_CPU, min([most, *known]), hard)
    try:
        yield
    finally:
        _set(resource.RLIMIT_CPU, before, hard)


def _set(kind: int, soft: int, hard: int) -> None:
    with suppress(ValueError, OSError):  # A lower limit is there already, or the system has none.
        resource.setrlimit(kind, (soft, hard))
