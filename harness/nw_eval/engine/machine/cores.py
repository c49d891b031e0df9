"""How many trials this machine runs at a time."""

from __future__ import annotations

import os


def default_workers() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def worker_count(wanted: int | None, jobs: int) -> int:
    """Return the number of workers that have something to do.

    Args:
        wanted: one for each core if None.
        jobs: those that are to be run.
    """
    return max(1, min(default_workers() if wanted is None else wanted, jobs))
