"""What this process does while others run its trials."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from collections.abc import Callable

    from nw_eval.engine.workers.protocol import Hire, Workers


class Meanwhile:
    """Gets workers, and does something else once it has; a context manager.

    Before it has, whatever else this process does keeps the first trial waiting.

    Args:
        hire: gets the workers.
        work: done once, in a thread of its own; at the block's end if there was nothing to run. The
            block's end waits for it, and raises what it raises.
    """

    def __init__(self, hire: Hire, work: Callable[[], None]) -> None:
        self._hire = hire
        self._work = work
        self._thread = ThreadPoolExecutor(max_workers=1)
        self._done: Future[None] | None = None

    @property
    def again(self) -> str:
        """Where a job that is run again runs."""
        return self._hire.again

    def __call__(self, count: int, *, fresh: bool) -> Workers:
        """Return workers."""
        workers = self._hire(count, fresh=fresh)
        self._begin()
        return workers

    def __enter__(self) -> Self:
        return self

    def __exit__(self, failure: object, *_: object) -> None:
        with self._thread:
            if failure is None:
                self._begin().result()

    def _begin(self) -> Future[None]:
        if self._done is None:
            self._done = self._thread.submit(self._work)
        return self._done
