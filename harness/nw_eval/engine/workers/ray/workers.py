"""Workers on the nodes of a cluster: a queue here, and a station on each node that is ready."""

from __future__ import annotations

import os
from collections import deque
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from secrets import token_hex
from time import monotonic, sleep
from typing import TYPE_CHECKING, Any, Self

from nw_eval.engine.machine.output import WorkerOutput
from nw_eval.engine.order import next_place
from nw_eval.engine.workers.protocol import Finished
from nw_eval.engine.workers.ray.logs import keep_log
from nw_eval.engine.workers.ray.node import Orders
from nw_eval.engine.workers.ray.nodes import Nodes
from nw_eval.engine.workers.ray.parcels import Outgoing
from nw_eval.engine.workers.ray.station import Answer, Station
from nw_eval.errors import TrialError, UsageError
from nw_eval.policies.bundle import senses_by_code
from nw_eval.rollout.result import TrialResult

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from nw_eval.engine.listener import Listener
    from nw_eval.engine.plan import Plan
    from nw_eval.engine.workers.ray.connection import Joined
    from nw_eval.engine.workers.ray.nodes import Node
    from nw_eval.results.run_folder import RunFolder
    from nw_eval.rollout.job import TrialJob

POLL = 0.1  # s between two looks at whether somebody asked to stop
# Seconds beyond a trial's limit after which its node, which would have said `hung`, is silent.
_SILENCE = 600.0
# Seconds in which a node must have as many cores free as it has, or half of them are tried.
_OPENING = 60.0


class RayProcesses:
    """Gets worker processes on the nodes of a cluster; a context manager that tidies up there.

    Args:
        plan: what is run.
        jobs: all of the run.
        folder: of the run.
        joined: the cluster.
        listener: hears of nodes that are refused or lost.

    Raises:
        UsageError: what the run needs cannot be sent, or rendered there.
    """

    again = "in a fresh process"

    def __init__(
        self,
        plan: Plan,
        jobs: Sequence[TrialJob],
        folder: RunFolder,
        *,
        joined: Joined,
        listener: Listener,
    ) -> None:
        if plan.render != "cpu":
            raise UsageError(
                f"--render {plan.render} with --engine ray, which renders on processors",
                fix="drop one of them",
            )
        self._joined = joined
        self._folder = folder
        self._one_each = tuple({job.trial.scene: job for job in jobs}.values())
        outgoing = Outgoing(plan)
        self._orders = Orders(
            token=token_hex(8),
            scenes=tuple((found.reference, found.collision) for found in plan.found),
            parcels=outgoing.parcels,
            render=plan.render,
            renders=plan.renders,
            memory_limit=plan.memory_limit,
        )
        question = {
            "render": plan.render,
            "adapter": plan.bundle.card.adapter,
            "code": plan.request.allow_code and senses_by_code(plan.bundle.card),
        }
        self._nodes = Nodes(joined, self._orders, outgoing, question, listener)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._nodes.tidy()

    def __call__(self, count: int, *, fresh: bool) -> RayWorkers:
        """Return workers: `count` processes, each for many jobs or for one."""
        return RayWorkers(
            count,
            joined=self._joined,
            nodes=self._nodes,
            station=(self._orders, self._one_each, fresh),
            output=WorkerOutput(self._folder.workers_log),
        )


@dataclass(kw_only=True, eq=False)
class _Staffed:
    """A station as the head knows it."""

    node: Node
    actor: Any
    workers: int
    awaited: Any
    """Ray's reference to what it says next; None = it has not been asked."""
    is_open: bool = False
    opened_by: float
    """When it must be open: another job of the cluster's may have cores of its node."""
    jobs: dict[str, tuple[TrialJob, float]] = field(
        default_factory=dict[str, "tuple[TrialJob, float]"]
    )
    """What it has begun, by the trial's id, and when the head gives it up."""
    scenes: set[str] = field(default_factory=set[str])

    @property
    def is_late(self) -> bool:
        """Whether its node is silent."""
        now = monotonic()
        if not self.is_open:
            return now > self.opened_by
        return any(now > deadline for _, deadline in self.jobs.values())


class RayWorkers:
    """Stations on nodes, with a queue; a context manager.

    Args:
        workers: number of jobs that run at a time.
        joined: the cluster.
        nodes: of the cluster.
        station: orders, jobs and `fresh` of `Station`.
        output: where what workers print goes; not entered yet.
    """

    def __init__(
        self,
        workers: int,
        *,
        joined: Joined,
        nodes: Nodes,
        station: tuple[Orders, Sequence[TrialJob], bool],
        output: WorkerOutput,
    ) -> None:
        self._count = workers
        self._joined = joined
        self._nodes = nodes
        self._station = station
        self._output = output
        self._cleanup = ExitStack()
        self._queue: deque[TrialJob] = deque()
        self._staff: list[_Staffed] = []

    def __enter__(self) -> Self:
        self._cleanup.enter_context(self._output)
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def submit(self, jobs: Iterable[TrialJob]) -> None:
        """Queue jobs, in order."""
        self._queue.extend(jobs)

    def finished(self) -> Iterator[Finished | None]:
        """Yield jobs as they end, and None about ten times a second while none does.

        Raises:
            PrerequisiteError, TrialError: no node can be used, or none is left.
        """
        while self._queue or any(each.jobs for each in self._staff):
            self._nodes.look()
            self._open()
            for each in self._staff:
                if each.is_open and each.awaited is None:
                    self._ask(each)
            ended = [done for each in self._heard() for done in self._look(each)]
            yield from ended or (None,)

    def stop(self) -> None:
        """End every station now, running trials included; calling it again does nothing."""
        self._queue.clear()
        while self._staff:
            self._leave(self._staff[-1])
        self._cleanup.close()

    def _open(self) -> None:
        """Open stations on nodes that have none, for as many workers as have something to do."""
        begun = sum(len(each.jobs) for each in self._staff)
        wanted = min(self._count, len(self._queue) + begun)
        wanted -= sum(each.workers for each in self._staff)
        staffed = {each.node.id for each in self._staff}
        for node in [node for node in self._nodes.ready if node.id not in staffed]:
            workers = min(wanted, node.cores)
            if workers < 1 or not self._joined.check():
                return
            wanted -= workers
            orders, jobs, fresh = self._station
            actor = self._joined.on(node.id, Station, cores=workers).remote(
                orders, jobs, workers, fresh=fresh
            )
            self._staff.append(
                _Staffed(
                    node=node,
                    actor=actor,
                    workers=workers,
                    awaited=actor.open.remote(),
                    opened_by=monotonic() + _OPENING,
                )
            )

    def _ask(self, each: _Staffed) -> None:
        """Give a station what it has workers for, and ask what it has come to."""
        jobs_to_go: list[TrialJob] = []
        while self._queue and len(each.jobs) < each.workers:
            job = self._next(each)
            each.jobs[job.trial.id] = job, monotonic() + job.time_limit + _SILENCE
            each.scenes.add(job.trial.scene)
            jobs_to_go.append(job)
        if each.jobs:
            each.awaited = each.actor.work.remote(jobs_to_go)

    def _next(self, each: _Staffed) -> TrialJob:
        """Take a station's next job from the queue."""
        taken = {scene for other in self._staff for scene in other.scenes}
        place = next_place((job.trial for job in self._queue), own=each.scenes, taken=taken)
        job = self._queue[place]
        del self._queue[place]
        return job

    def _heard(self) -> list[_Staffed]:
        """Wait a moment; return stations that have said something, or should have long ago."""
        pending = {each.awaited: each for each in self._staff if each.awaited is not None}
        if not pending:
            sleep(POLL)
            return []
        answered, _ = self._joined.ray.wait(list(pending), timeout=POLL)
        if answered:  # Whatever else is there by now.
            answered, _ = self._joined.ray.wait(list(pending), num_returns=len(pending), timeout=0)
        there = {*answered}
        return [each for each in pending.values() if each.awaited in there or each.is_late]

    def _look(self, each: _Staffed) -> Iterator[Finished]:
        """Take in what a station says, and yield jobs that have ended."""
        try:
            answer: Answer | None = self._joined.ray.get(each.awaited, timeout=POLL)
        except self._joined.ray.exceptions.RayError as error:
            self._leave(each)
            yield from self._lost(each, error)
            return
        each.awaited, each.is_open = None, True
        if answer is None:
            return
        each.node.strikes = 0
        with suppress(OSError):
            os.write(self._output.end.fileno(), answer.printed)
        job, _ = each.jobs.pop(answer.trial)
        yield Finished(job=job, result=keep_log(answer, job), host=answer.host)

    def _lost(self, each: _Staffed, error: Exception) -> Iterator[Finished]:
        """Yield what the jobs of a station that is gone came to: an error, if they were begun."""
        node = each.node
        if not each.is_open and each.is_late:
            node.cores = max(1, each.workers // 2)  # Somebody else has the others.
            return
        self._nodes.strike(node, error)
        jobs = [job for job, _ in each.jobs.values()]
        if isinstance(getattr(error, "cause", None), TrialError):  # No worker could begin one.
            self._queue.extendleft(reversed(jobs))
            self._nodes.refuse(node, error)
            return
        text = f"node {node.name}, or its workers' supervisor there, was lost"
        result = TrialResult(status="error", error_type="crashed", error_text=text)
        yield from (Finished(job=job, result=result) for job in jobs)

    def _leave(self, each: _Staffed) -> None:
        self._staff.remove(each)
        if self._joined.answers:
            with suppress(self._joined.ray.exceptions.RayError, ValueError):  # It is gone already.
                self._joined.ray.kill(each.actor, no_restart=True)
