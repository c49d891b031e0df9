"""What a process may do, its memory and time, and the making of it so."""

from __future__ import annotations

import math
import resource
from collections.abc import Generator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from nw_eval.confinement.family import die_with_parent, leave_terminal
from nw_eval.confinement.fence import Fence, raise_fence
from nw_eval.confinement.seccomp import Network

_OPENING = 2**30
"""Bytes to open a small file in. Measured: libraries take 60 to 280 MB of it."""

_RUNNING = 2**31
"""Bytes to run trials in, without their scenes."""
_SCENE = 2**28
"""Bytes that a scene may take, with its rays and its physics."""
_SCENES = 32
"""Scenes that a process keeps at once."""
_COPIES = 8
"""Copies of a file that its reader may have at once: bytes, members, tensors, a graph's own."""


@dataclass(frozen=True, kw_only=True)
class Rules:
    """What a process may do from its start on."""

    reads: tuple[Path, ...] = ()
    """Files and folders that it reads, besides those of libraries."""
    writes: tuple[Path, ...] = ()
    """Folders in which it makes, writes and removes files."""
    network: Network = "none"
    memory: int | None = _OPENING
    """Bytes of its own; None = as many as there are."""
    seconds: int | None = None
    """Of processor time; None = any."""
    python: Path | None = None
    """The interpreter that runs it, where that is not this one."""
    off: str = ""
    """Why there is neither fence nor limit; empty = there are."""


def confine(rules: Rules, *, output: int | None = None) -> Fence:
    """Confine this process: at its start, before it has other threads or an untrusted file.

    Args:
        rules: what it may do.
        output: file descriptor for what it prints; None = nowhere.

    Returns:
        What the kernel did of it.
    """
    leave_terminal(output)
    die_with_parent(has_children=bool(rules.off))
    if rules.off:
        limit(memory=None, seconds=None)
        return Fence(off=rules.off)
    limit(memory=rules.memory, seconds=rules.seconds)
    return raise_fence(reads=rules.reads, writes=rules.writes, network=rules.network)


def memory_to_open(size: int) -> int:
    """Return how many bytes a process may hold that opens a file of `size` bytes."""
    return _OPENING + _COPIES * size


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
