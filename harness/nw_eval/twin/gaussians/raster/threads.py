"""A few threads that share one frame. What they compute does not depend on how many they are."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

from nw_eval.errors import UsageError

_BLOCK = 4096
"""Gaussians that one job handles."""


class Threads:
    """Runs jobs that write to places of their own.

    Args:
        threads: how many at once.

    Raises:
        UsageError: fewer than one.
    """

    def __init__(self, threads: int = 1) -> None:
        if threads < 1:
            raise UsageError(f"threads is {threads}", fix="give 1 or more")
        self._pool = ThreadPoolExecutor(threads) if threads > 1 else None

    def run(self, jobs: list[Callable[[], None]]) -> None:
        """Run all jobs, in any order, and return when all are done."""
        if self._pool is None:
            for job in jobs:
                job()
        else:
            for done in [self._pool.submit(job) for job in jobs]:
                done.result()

    def over(self, count: int, job: Callable[[int, int], None]) -> None:
        """Run job(first, end) over all blocks of `count` items."""
        edges = [*range(0, count, _BLOCK), count]

        def bind(first: int, end: int) -> Callable[[], None]:
            return lambda: job(first, end)

        self.run([bind(first, end) for first, end in pairwise(edges)])
