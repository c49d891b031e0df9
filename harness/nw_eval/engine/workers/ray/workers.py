"""Workers on the nodes of a cluster: a queue here, a seat there for each trial that runs."""

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
from nw_eval.engine.workers.ray.seat import Answer, Seat
from nw_eval.errors import TrialError, UsageError
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
        )
        question = {
            "render": plan.render,
            "adapter": plan.bundle.card.adapter,
            "allow_code": plan.request.allow_code,
        }
        self._nodes = Nodes(joined, self._orders, outgoing, question, listener)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._nodes.tidy()

    def __call__(self, count: int, *, fresh: bool) -> RayWorkers:
        """Return workers: `count` seats, whose processes are each for many jobs or for one."""
        return RayWorkers(
            count,
            joined=self._joined,
            nodes=self._nodes,
            seat=(self._orders, self._one_each, fresh),
            output=WorkerOutput(self._folder.workers_log),
        )


@dataclass(kw_only=True, eq=False)
class _Taken:
    """A seat as the head knows it."""

    node: Node
    actor: Any
    awaited: Any
    """Ray's reference to what it says next: that it is open, or an `Answer`; None = nothing."""
    job: TrialJob | None = None
    deadline: float = 0.0
    scenes: set[str] = field(default_factory=set[str])


class RayWorkers:
    """Seats on nodes, with a queue; a context manager.

    Args:
        workers: number of seats.
        joined: the cluster.
        nodes: of the cluster.
        seat: orders, jobs and `fresh` of `Seat`.
        output: where what workers print goes; not entered yet.
    """

    def __init__(
        self,
        workers: int,
        *,
        joined: Joined,
        nodes: Nodes,
        seat: tuple[Orders, Sequence[TrialJob], bool],
        output: WorkerOutput,
    ) -> None:
        self._count = workers
        self._joined = joined
        self._nodes = nodes
        self._seat = seat
        self._output = output
        self._cleanup = ExitStack()
        self._queue: deque[TrialJob] = deque()
        self._taken: list[_Taken] = []

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
        while self._queue or any(each.job is not None for each in self._taken):
            self._nodes.look()
            self._open()
            self._hand_out()
            ended = [done for each in self._heard() if (done := self._look(each)) is not None]
            yield from ended or (None,)

    def stop(self) -> None:
        """End every seat now, running trials included; calling it again does nothing."""
        self._queue.clear()
        while self._taken:
            self._leave(self._taken[-1])
        self._cleanup.close()

    def _open(self) -> None:
        """Open one more seat on each node that has room, up to as many as have something to do."""
        busy = sum(each.job is not None for each in self._taken)
        wanted = min(self._count, len(self._queue) + busy) - len(self._taken)
        rooms = {
            node.id: (node, node.cores - sum(each.node is node for each in self._taken))
            for node in self._nodes.ready
        }
        for _ in range(wanted):
            node, room = max(rooms.values(), key=lambda each: each[1], default=(None, 0))
            if node is None or room < 1:
                return
            rooms[node.id] = (node, room - 1)
            orders, jobs, fresh = self._seat
            actor = self._joined.on(node.id, Seat, cores=1).remote(orders, jobs, fresh=fresh)
            self._taken.append(_Taken(node=node, actor=actor, awaited=actor.open.remote()))

    def _hand_out(self) -> None:
        for each in self._taken:
            if self._queue and each.awaited is None:
                each.job = self._next(each)
                each.scenes.add(each.job.trial.scene)
                each.deadline = monotonic() + each.job.time_limit + _SILENCE
                each.awaited = each.actor.run.remote(each.job)

    def _next(self, each: _Taken) -> TrialJob:
        """Take a seat's next job from the queue."""
        others = {scene for other in self._taken for scene in other.scenes}
        place = next_place((job.trial for job in self._queue), own=each.scenes, taken=others)
        job = self._queue[place]
        del self._queue[place]
        return job

    def _heard(self) -> list[_Taken]:
        """Wait a moment; return the seats that have said something, or should have long ago."""
        asked = {each.awaited: each for each in self._taken if each.awaited is not None}
        if not asked:
            sleep(POLL)
            return []
        said, _ = self._joined.ray.wait(list(asked), timeout=POLL)
        if said:  # Whatever else is there by now.
            said, _ = self._joined.ray.wait(list(asked), num_returns=len(asked), timeout=0)
        late = [each for each in self._taken if each.job and monotonic() > each.deadline]
        return list({id(each): each for each in (*map(asked.__getitem__, said), *late)}.values())

    def _look(self, each: _Taken) -> Finished | None:
        """Return what a seat's job came to, if it had one."""
        job = each.job
        try:
            answer: Answer | bool = self._joined.ray.get(each.awaited, timeout=POLL)
        except self._joined.ray.exceptions.RayError as error:
            self._leave(each)
            return self._lost(each.node, job, error)
        each.awaited, each.job = None, None
        if job is None or isinstance(answer, bool):
            return None
        each.node.strikes = 0
        with suppress(OSError):
            os.write(self._output.end.fileno(), answer.printed)
        return Finished(job=job, result=keep_log(answer, job), host=answer.host)

    def _lost(self, node: Node, job: TrialJob | None, error: Exception) -> Finished | None:
        """Return what the job of a seat that is gone came to: an error, if it was begun."""
        self._nodes.strike(node, error)
        if job is None:
            return None
        if isinstance(getattr(error, "cause", None), TrialError):  # No worker could begin it.
            self._queue.appendleft(job)
            self._nodes.refuse(node, error)
            return None
        text = f"node {node.name}, or its worker's supervisor there, was lost"
        return Finished(
            job=job, result=TrialResult(status="error", error_type="crashed", error_text=text)
        )

    def _leave(self, each: _Taken) -> None:
        self._taken.remove(each)
        with suppress(Exception):  # It is gone already, or the cluster is.
            self._joined.ray.kill(each.actor, no_restart=True)
