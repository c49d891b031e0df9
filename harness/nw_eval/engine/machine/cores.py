"""How many trials this machine runs at a time."""

from __future__ import annotations

from nw_eval.results.machine import usable_cores


def worker_count(wanted: int | None, jobs: int) -> int:
    """Return the number of workers that have something to do.

    Args:
        wanted: one for each core if None.
        jobs: those that are to be run.
    """
    return max(1, min(usable_cores() if wanted is None else wanted, jobs))
