"""Worker processes on this machine: each trial in one of them, each fault in one trial.

A worker that is killed costs its trial (`crashed`), one that does not come back within the
trial's time limit is killed (`hung`), and both are replaced. Workers are started by `spawn`:
nothing is inherited from the parent but one thread for each library.
"""

from __future__ import annotations

import signal
from collections import deque
from concurrent.futures import CancelledError
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from multiprocessing.context import SpawnContext, SpawnProcess
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, Self

from pebble import ProcessExpired, ProcessPool

from nw_eval.confinement import child_environment, interrupts_blocked
from nw_eval.engine import worker
from nw_eval.errors import TrialError
from nw_eval.rollout.result import TrialResult

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from concurrent.futures import Future

    from nw_eval.engine.output import WorkerOutput
    from nw_eval.engine.worker import WorkerStart
    from nw_eval.rollout.job import TrialJob

# Trials that a worker runs before a fresh one takes its place: a leak has an end.
RECYCLE_AFTER = 100
# Seconds between two looks at whether somebody asked to stop.
POLL = 0.1
# Jobs handed to the pool for each worker: one that runs and some that wait, so that none idles.
# The others stay here, or they would fill the pipe to the workers and block its thread.
_IN_HAND = 3
# Times that a whole pool may die (all workers killed while idle, no memory to start one).
_REBUILDS = 3


@dataclass(frozen=True, kw_only=True)
class Finished:
    """A job that came to an end, whatever end."""

    job: TrialJob
    result: TrialResult


class _TrackedSpawn(SpawnContext):
    """A spawn context that knows the processes it started, so that exactly those can be killed."""

    def __init__(self) -> None:
        super().__init__()
        self.started: list[SpawnProcess] = []

    def Process(self, *args: Any, **kwargs: Any) -> SpawnProcess:  # type: ignore[override]  # noqa: N802 - multiprocessing's name.
        process = SpawnProcess(*args, **kwargs)
        self.started.append(process)
        return process


class LocalWorkers:
    """A pool of worker processes; a context manager.

    Args:
        workers: number of processes.
        start: what each of them starts with.
        output: where what they print goes.
        recycle_after: jobs that a process runs before it is replaced; 1 = each job in a fresh one.
    """

    def __init__(
        self,
        workers: int,
        *,
        start: WorkerStart,
        output: WorkerOutput,
        recycle_after: int = RECYCLE_AFTER,
    ) -> None:
        self._count = workers
        self._start_with = start
        self._output = output
        self._recycle_after = recycle_after
        self._context = _TrackedSpawn()
        self._pool: ProcessPool | None = None
        self._cleanup = ExitStack()
        self._queue: deque[TrialJob] = deque()
        self._running: dict[Future[TrialResult], TrialJob] = {}  # in the pool, some yet to start
        self._done: SimpleQueue[Future[TrialResult]] = SimpleQueue()
        self._rebuilds = 0

    def __enter__(self) -> Self:
        self._cleanup.enter_context(child_environment(fenced=not self._start_with.rules.off))
        self._start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def submit(self, jobs: Iterable[TrialJob]) -> None:
        """Queue jobs, in order."""
        self._queue.extend(jobs)

    def finished(self) -> Iterator[Finished | None]:
        """Yield jobs as they end, and None about ten times a second while none does.

        Raises:
            TrialError: workers cannot be kept alive at all.
        """
        while self._queue or self._running:
            self._feed()
            try:
                future = self._done.get(timeout=POLL)
            except Empty:
                yield None
                continue
            job = self._running.pop(future, None)
            if job is None:
                continue  # Of a pool that was replaced: the job is queued again.
            result = _result(job, future)
            if result is None:
                self._rebuild(job)
            else:
                yield Finished(job=job, result=result)

    def stop(self) -> None:
        """End every worker now, running trials included; calling it again does nothing."""
        pool, self._pool = self._pool, None
        if pool is not None:
            self._queue.clear()
            self._running.clear()
            pool.stop()
            # A trial holds nothing that needs an orderly end, and one that hangs ignores SIGTERM.
            self.kill()
            with suppress(RuntimeError):
                pool.join()
        self._cleanup.close()

    def kill(self) -> None:
        """Send SIGKILL to every worker, without waiting."""
        for process in self._context.started:
            with suppress(ValueError, AttributeError):
                process.kill()

    def _start(self) -> None:
        self._pool = ProcessPool(
            max_workers=self._count,
            max_tasks=self._recycle_after,
            initializer=worker.start,
            initargs=(self._start_with, self._output.end),
            context=self._context,  # type: ignore[arg-type]
        )
        with interrupts_blocked():
            is_running = self._pool.active  # Asking starts its threads and workers.
        if not is_running:
            raise TrialError("worker processes cannot be started", fix="use fewer --workers")

    def _feed(self) -> None:
        """Hand jobs to the pool until it has enough."""
        assert self._pool is not None, "use LocalWorkers in a with statement"
        try:
            while self._queue and len(self._running) < _IN_HAND * self._count:
                job = self._queue[0]
                future = self._pool.schedule(worker.run_job, args=(job,), timeout=job.time_limit)
                self._queue.popleft()
                self._running[future] = job
                future.add_done_callback(self._done.put)
        except RuntimeError:  # The pool has broken; its jobs say so when their turn comes.
            if not self._running:
                self._rebuild()

    def _rebuild(self, *broken: TrialJob) -> None:
        """Replace a pool that died as a whole, and queue again what it had not finished."""
        self._rebuilds += 1
        if self._rebuilds > _REBUILDS:
            raise TrialError(
                f"worker processes died {self._rebuilds} times before they could take a trial",
                fix="look for the out-of-memory killer in the system log, or use fewer --workers",
            )
        self._queue.extendleft(reversed([*broken, *self._running.values()]))
        self._running.clear()
        if self._pool is not None:
            self._pool.stop()
            self.kill()
            with suppress(RuntimeError):
                self._pool.join()
        self._start()


def _result(job: TrialJob, future: Future[TrialResult]) -> TrialResult | None:
    """Return what a job came to; None if its pool died around it and it should run again."""
    try:
        return future.result()
    except TimeoutError:
        return TrialResult(
            status="error",
            error_type="hung",
            error_text=f"no result within {job.time_limit:g} s; raise --time-limit if the machine "
            "is slow, or look at the policy",
        )
    except ProcessExpired as error:
        return TrialResult(status="error", error_type="crashed", error_text=_death(error.exitcode))
    except (BrokenProcessPool, CancelledError):
        return None
    except Exception as error:  # noqa: BLE001 - an error that travelled from the worker.
        return TrialResult(
            status="error", error_type="crashed", error_text=f"{type(error).__name__}: {error}"
        )


def _death(code: int | None) -> str:
    if code is not None and code < 0:
        name = signal.Signals(-code).name
        hint = "; the machine may be out of memory" if -code == signal.SIGKILL else ""
        return f"the worker process was killed by {name}{hint}"
    return f"the worker process ended with exit code {code}"
