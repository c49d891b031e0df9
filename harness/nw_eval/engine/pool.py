"""Workers: a queue that jobs go into and results come out of, wherever they run."""

from __future__ import annotations

from collections import deque
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, Self

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from nw_sim.rollout.job import TrialJob, TrialResult


@dataclass(frozen=True, kw_only=True)
class Finished:
    """A job that came to an end, whatever end."""

    job: TrialJob
    result: TrialResult
    host: str = ""
    """The machine that it ran on; empty = this one."""


class Workers(Protocol):
    """Whoever runs jobs; a context manager that stops them.

    What a job comes to depends on the job alone. A worker that is lost costs the jobs that it had:
    each of them ends, with an error.
    """

    def __enter__(self) -> Self:
        """Start no more than what `submit` needs."""
        ...

    def __exit__(self, *_: object) -> None:
        """Stop."""
        ...

    def submit(self, jobs: Iterable[TrialJob]) -> None:
        """Queue jobs, in the order in which they are best started; also when others have ended."""
        ...

    def finished(self) -> Iterator[Finished | None]:
        """Yield every queued job as it ends, once, and None now and then while none does.

        It ends when all of them have. Whoever reads it may stop reading at any time.

        Raises:
            TrialError: no workers can be had at all.
        """
        ...

    def stop(self) -> None:
        """Drop the queue and end running trials; calling it again does nothing."""
        ...


class StartWorkers(Protocol):
    """Gets workers for the jobs of one run."""

    @property
    def again(self) -> str:
        """Where a job that is run again runs, in words: `in a fresh process`."""
        ...

    def __call__(self, count: int, *, fresh: bool) -> Workers:
        """Return workers.

        Args:
            count: how many jobs may run at a time, at most.
            fresh: whether each job has a process of its own, where there is one to be had.
        """
        ...


class QueuedWorkers:
    """What all `Workers` have: a queue, and what is to be closed at the end."""

    def __init__(self) -> None:
        self._queue: deque[TrialJob] = deque()
        self._cleanup = ExitStack()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def submit(self, jobs: Iterable[TrialJob]) -> None:
        """Queue jobs, in order."""
        self._queue.extend(jobs)

    def stop(self) -> None:
        """Drop the queue; calling it again does nothing."""
        self._queue.clear()
        self._cleanup.close()
