"""What a process started, as Linux tells it: proc(5), `children` of its threads and `stat`."""

from __future__ import annotations

import os
import signal
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

_PROC = Path("/proc")


def can_be_listed() -> bool:
    """Whether this system says what a process has started."""
    return (_PROC / f"self/task/{os.getpid()}/children").exists()


def descendants(process: int) -> list[int]:
    """Return what a process, or any of its threads, started, and what that did.

    Whatever session it is in; but what has lost its parent is not among it.
    """
    found: list[int] = []
    for each in _children(process):
        found += [each, *descendants(each)]
    return found


def left_by(leader: int) -> list[int]:
    """Return what is left of the session of a process that has ended and is waited for.

    It costs some ms. A number that is another process's by now leaves nothing.
    """
    if (_PROC / str(leader)).exists():
        return []
    found: list[int] = []
    for entry in _PROC.iterdir():
        with suppress(OSError, ValueError, IndexError):
            # The name of a program, in brackets, may hold anything.
            state = text_of(f"{entry}/stat").rpartition(")")[2].split()
            if int(state[3]) == leader:
                found.append(int(entry.name))
    return found


def kill(processes: Iterable[int]) -> None:
    """End processes, at once."""
    for each in processes:
        with suppress(OSError):
            os.kill(each, signal.SIGKILL)


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
        return content.decode()
    finally:
        os.close(file)


def _children(process: int) -> list[int]:
    found: list[int] = []
    with suppress(OSError):  # It has ended.
        for thread in os.listdir(f"/proc/{process}/task"):  # noqa: PTH208 - Path takes tenfold.
            found += map(int, text_of(f"/proc/{process}/task/{thread}/children").split())
    return found
