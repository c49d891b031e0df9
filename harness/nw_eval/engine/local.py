"""Worker processes on this machine: each trial in one of them, each fault in one trial.

A worker that dies costs its trial (`crashed`), one that hangs, or does not come back within the
trial's time limit, is killed (`hung`), and both are replaced. They come from
`nw_sim.rollout.confined.start`: nothing is inherited from the parent but one thread for each
library.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from functools import partial
from multiprocessing.connection import wait
from typing import TYPE_CHECKING, Self

from nw_base.errors import PrerequisiteError, TrialError
from nw_eval.engine import worker
from nw_eval.engine.machine import WorkerOutput, can_be_listed, restrained
from nw_eval.engine.order import next_place
from nw_eval.engine.pool import Finished, QueuedWorkers
from nw_eval.engine.prepare import needs_splats
from nw_eval.engine.worker import UnstartedError, WorkerProcess, WorkerStart
from nw_policies import load_bundle
from nw_scenes.robots import know_robot
from nw_sim.rollout.confined.access import policy_rules, running_rules
from nw_sim.rollout.job import kernels_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from nw_eval.engine.prepare import SplatBuilders
    from nw_gate.results.run_folder import RunFolder
    from nw_sim.rollout.job import TrialJob, TrialResult

    Run = Callable[[TrialJob], TrialResult]

# Trials that a worker runs before a fresh one takes its place: a leak has an end.
RECYCLE_AFTER = 100
# Seconds between two looks at whether somebody asked to stop.
POLL = 0.1
# Processes in a row, for each worker, that may die before they take a trial (killed while they
# start, no memory).
_MOST_FAILED_STARTS = 3


class LocalProcesses:
    """Gets worker processes on this machine.

    Args:
        jobs: all of the run.
        folder: the run's folder.
        run: called with each job in a worker.
        memory_limit: bytes that a worker may hold with its children.
        builders: of splats that are not there yet; None = all are.

    Raises:
        PolicyError, SceneError: policy or scenes are not where the jobs say.
        PrerequisiteError: this system cannot hold them to a memory limit.
    """

    again = "in a fresh process"

    def __init__(
        self,
        jobs: Sequence[TrialJob],
        folder: RunFolder,
        *,
        run: Run = worker.run_job,
        memory_limit: int | None = None,
        builders: SplatBuilders | None = None,
    ) -> None:
        if memory_limit is not None and not can_be_listed():
            raise PrerequisiteError(
                "--memory-limit: this system does not report the memory of processes and children",
                fix="drop it, or run on Linux with /proc",
            )
        job = jobs[0]
        know_robot(job.robot, job.robot_folder)
        bundle = load_bundle(job.policy, checkpoint=job.checkpoint)
        rules = running_rules(
            bundle,
            scenes=[each.scene for each in jobs],
            logs=folder.logs,
            allow_code=job.allow_code,
            render=job.render,
            also=job.also,
        )
        policy = policy_rules(bundle)
        draws = any(needs_splats(bundle.card, each.record) for each in jobs) and not rules.off
        kernels = kernels_of(job.robot, bundle.card, job.rendering.projection) if draws else ()
        self._start = WorkerStart(
            rules=restrained(rules, memory_limit),
            renders=kernels,
            policy=restrained(policy, memory_limit),
            awaits_splats=builders is not None and builders.on_demand,
        )
        self._builders = builders
        self._printed = folder.workers_log
        self._run = run
        self._memory_limit = memory_limit

    def __call__(self, count: int, *, fresh: bool) -> LocalWorkers:
        """Return workers: `count` processes, each for many jobs or for one."""
        return LocalWorkers(
            count,
            start=self._start,
            run=self._run,
            output=WorkerOutput(self._printed),
            recycle_after=1 if fresh else RECYCLE_AFTER,
            memory_limit=self._memory_limit,
            builders=self._builders,
        )


@dataclass(eq=False)
class LocalWorkers(QueuedWorkers):
    """Worker processes with a queue; a context manager."""

    workers: int
    """Number of processes."""
    _: KW_ONLY
    start: WorkerStart
    """What each of them starts with."""
    run: Run
    """Called there with each job."""
    output: WorkerOutput
    """Where what they print goes; not entered yet."""
    recycle_after: int = RECYCLE_AFTER
    """Jobs that a process runs before it is replaced; 1 = each job in a fresh one."""
    memory_limit: int | None = None
    """Bytes that a process may hold with its children."""
    builders: SplatBuilders | None = None
    """Of splats that are not there yet, which take the cores that no trial can use; None = all are
    there."""

    def __post_init__(self) -> None:
        super().__init__()
        self._busy: list[WorkerProcess] = []
        self._idle: list[WorkerProcess] = []  # For jobs to come: they have scenes loaded.
        self._failed_starts = 0

    def __enter__(self) -> Self:
        self._cleanup.enter_context(self.output)
        return self

    def finished(self) -> Iterator[Finished | None]:
        """Yield jobs as they end, and None about ten times a second while none does.

        Raises:
            TrialError: workers cannot be kept alive at all.
            SceneError, StoreError: a splat cannot be built.
        """
        while self._queue or self._busy:
            if self.builders is not None:
                self.builders.repair()
            while self._queue and len(self._busy) < self.workers:
                each = self._idle[-1] if self._idle else None
                place = self._next(each)
                if place < 0:
                    break
                self._busy.append(self._started() if each is None else self._idle.pop())
                self._give(self._busy[-1], place)
            self._build()
            wait([handle for each in self._busy for handle in each.handles], POLL)
            ended = [done for each in tuple(self._busy) if (done := self._look(each)) is not None]
            yield from ended or (None,)

    def stop(self) -> None:
        """End every worker now, running trials included; calling it again does nothing."""
        # A trial holds nothing that needs an orderly end, and one that hangs ignores SIGTERM.
        for each in (*self._busy, *self._idle):
            each.kill()
        for ended in (self._busy, self._idle):
            while ended:
                ended.pop().close()
        super().stop()

    def _started(self) -> WorkerProcess:
        """Return one more worker."""
        try:
            return WorkerProcess(
                start=partial(worker.start, self.start),
                run=self.run,
                rules=self.start.rules,
                policy=self.start.policy,
                output=self.output.end,
                memory_limit=self.memory_limit,
            )
        except OSError as error:
            raise TrialError(
                f"worker processes cannot be started: {error.strerror or error}",
                fix="use fewer --workers",
            ) from error

    def _next(self, each: WorkerProcess | None) -> int:
        """Return the position in the queue of a worker's next job; -1 if it has to wait.

        A job of a scene that is not built yet waits for it. The worker's core builds one, if there
        is one to build, rather than run ahead in the order.

        Args:
            each: the worker; None = one that is not started yet.
        """
        own = set[str]() if each is None else each.scenes
        taken = {scene for other in (*self._busy, *self._idle) for scene in other.scenes}
        trials = [job.trial for job in self._queue]
        builders = self.builders
        if builders is None or builders.on_demand or not (held := {*builders.missing}):
            return next_place(trials, own=own, taken=taken)
        place = next_place(trials, own=own, taken=taken, held=held)
        if place < 0 and not builders.has_more:
            ready = [place for place, trial in enumerate(trials) if trial.scene not in held]
            if ready:
                place = ready[next_place((trials[p] for p in ready), own=own, taken=taken)]
        return place

    def _give(self, each: WorkerProcess, index: int) -> None:
        """Give a worker the job at a position in the queue."""
        each.give(self._queue[index])
        del self._queue[index]

    def _build(self) -> None:
        """Let splats be built on the cores on which no trial runs, those first that trials need."""
        builders = self.builders
        if builders is None or not builders.missing:
            return
        if not builders.on_demand:
            for job in self._queue:
                builders.want(job.trial.scene)
        waiting = [each for each in self._busy if each.awaits_splat]
        for each in waiting:
            assert each.job is not None, "a worker without a job is not in the list"
            builders.want(each.job.trial.scene)
        builders.allow(self.workers - len(self._busy) + len(waiting))

    def _look(self, each: WorkerProcess) -> Finished | None:
        """Return what a worker's job came to, if it did, and give the worker another one."""
        job = each.job
        assert job is not None, "a worker without a job is not in the list"
        count = each.jobs_done
        try:
            result = each.look(self.builders.missing if self.builders else ())
        except UnstartedError:
            self._end(each)
            self._queue.appendleft(job)
            self._failed_starts += 1
            if self._failed_starts > _MOST_FAILED_STARTS * self.workers:
                raise TrialError(
                    f"{self._failed_starts} worker processes in a row died before they could "
                    "take a trial",
                    fix="check the system log for the out-of-memory killer, or use fewer --workers",
                ) from None
            return None
        if result is None:
            return None
        self._failed_starts = 0
        is_well = each.jobs_done > count and each.jobs_done < self.recycle_after
        if not is_well:
            self._end(each)
        elif self._queue and (place := self._next(each)) >= 0:
            self._give(each, place)
        else:
            self._busy.remove(each)
            self._idle.append(each)
        return Finished(job=job, result=result)

    def _end(self, each: WorkerProcess) -> None:
        self._busy.remove(each)
        each.kill()
        each.close()
