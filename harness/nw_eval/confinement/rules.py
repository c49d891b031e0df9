"""What a process may do, and the making of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from nw_eval.confinement.calls import Network
from nw_eval.confinement.family import die_with_parent, leave_terminal
from nw_eval.confinement.fence import Fence, raise_fence
from nw_eval.confinement.limits import OPENING, limit


@dataclass(frozen=True, kw_only=True)
class Rules:
    """What a process may do from its start on."""

    reads: tuple[Path, ...] = ()
    """Files and folders that it reads, besides those of libraries."""
    writes: tuple[Path, ...] = ()
    """Folders in which it makes, writes and removes files."""
    network: Network = "none"
    memory: int | None = OPENING
    """Bytes of its own; None = as many as there are."""
    seconds: int | None = None
    """Of processor time; None = any."""
    python: Path | None = None
    """The interpreter that runs it, where that is not this one."""
    off: str = ""
    """Why there is neither fence nor limit; empty = there are."""


def confine(rules: Rules, *, output: int | None = None) -> Fence:
    """Confine this process: at its start, before it has other threads or a stranger's file.

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
