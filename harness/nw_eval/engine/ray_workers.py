"""Workers on the nodes of a cluster: a queue here, and a node agent on each node that is ready.

ray_connection.py    join a cluster, or start one on this machine
ray_file_bundles.py  what travels to nodes, by content, and where a node keeps what it got
ray_node.py          what a node is asked, and its worker processes, with one of Ray's between them
                     and the cluster

Policies never share a process with Ray: a node agent is an actor that owns confined processes,
those that the local engine starts, so that limits, fences, faults and bits are the same. There is
one for a node, and not for a core: its workers are forked from one process that has imported what
they need, share their pages, and keep to their scenes as on one machine.

The head asks nodes what they are, makes them ready, refuses them, loses them. Logs that came back
from a node are written into the run's folder by the head alone.
"""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass, field, replace
from secrets import token_hex
from time import monotonic, sleep
from typing import TYPE_CHECKING, Any, Literal, Self

from nw_base.clean import clean
from nw_base.errors import NwEvalError, PrerequisiteError, StoreError, TrialError, UsageError
from nw_base.files.cache import atomic_path
from nw_eval.engine import ray_node as there
from nw_eval.engine.machine import WorkerOutput
from nw_eval.engine.order import next_place
from nw_eval.engine.pool import Finished, QueuedWorkers
from nw_eval.engine.ray_file_bundles import Outgoing
from nw_eval.engine.ray_node import Answer, JobSpec, NodeAgent
from nw_policies.bundle import senses_by_code
from nw_sim.rollout.job import TrialResult

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from nw_eval.engine.listener import Listener
    from nw_eval.engine.plan import Plan
    from nw_eval.engine.ray_connection import Joined
    from nw_gate.results.run_folder import RunFolder
    from nw_sim.rollout.job import TrialJob

POLL = 0.1  # s between two looks at whether somebody asked to stop
# Seconds beyond a trial's limit after which its node, which would have said `hung`, is silent.
_NO_ANSWER = 600.0
# Seconds in which a node must have as many cores free as it has, or half of them are tried.
_OPENING = 60.0
# Seconds between two looks at which nodes there are, and for which there may be none.
_LOOK, _PATIENCE = 2.0, 60.0
_FAREWELL = 10.0  # s in which nodes tidy up
_PIECE = 2**24  # Bytes of a file that travel at once.
# Times that nothing could be started on a node, after which nothing more is; and seconds between
# them, in which the cluster finds out whether the node is there at all.
_STRIKES, _REST = 3, 5.0


class RayProcesses:
    """Gets worker processes on the nodes of a cluster; a context manager that tidies up there.

    Args:
        plan: what is run.
        jobs: all of the run.
        folder: the run's folder.
        joined: the cluster.
        listener: receives nodes that are refused or lost.

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
        self._spec = JobSpec(
            token=token_hex(8),
            scenes=tuple((found.reference, found.collision) for found in plan.found),
            file_bundles=outgoing.file_bundles,
            render=plan.render,
            renders=plan.renders,
            memory_limit=plan.memory_limit,
        )
        question = {
            "render": plan.render,
            "card": plan.bundle.card,
            "code": plan.request.allow_code and senses_by_code(plan.bundle.card),
            # Functions of the suite travel with the jobs: no node has a package of them.
            "plugins": {
                key: said for key, said in plan.plugins.items() if key not in plan.suite.own_code
            },
        }
        self._nodes = Nodes(joined, self._spec, outgoing, question, listener)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._nodes.tidy()

    def __call__(self, count: int, *, fresh: bool) -> RayWorkers:
        """Return workers: `count` processes, each for many jobs or for one."""
        return RayWorkers(
            workers=count,
            joined=self._joined,
            nodes=self._nodes,
            agent=(self._spec, self._one_each, fresh),
            output=WorkerOutput(self._folder.workers_log),
        )


@dataclass(kw_only=True, eq=False)
class _OpenAgent:
    """A node agent as the head knows it."""

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


@dataclass(kw_only=True, eq=False)
class RayWorkers(QueuedWorkers):
    """Stations on nodes, with a queue; a context manager."""

    workers: int
    """Number of jobs that run at a time."""
    joined: Joined
    nodes: Nodes
    """Of the cluster."""
    agent: tuple[JobSpec, Sequence[TrialJob], bool]
    """Spec, jobs and `fresh` of `NodeAgent`."""
    output: WorkerOutput
    """Where what workers print goes; not entered yet."""

    def __post_init__(self) -> None:
        super().__init__()
        self._agents: list[_OpenAgent] = []

    def __enter__(self) -> Self:
        self._cleanup.enter_context(self.output)
        return self

    def finished(self) -> Iterator[Finished | None]:
        """Yield jobs as they end, and None about ten times a second while none does.

        Raises:
            PrerequisiteError, TrialError: no node can be used, or none is left.
        """
        while self._queue or any(each.jobs for each in self._agents):
            self.nodes.look()
            self._open()
            for each in self._agents:
                if each.is_open and each.awaited is None:
                    self._ask(each)
            ended = [done for each in self._heard() for done in self._look(each)]
            yield from ended or (None,)

    def stop(self) -> None:
        """End every node agent now, running trials included; calling it again does nothing."""
        while self._agents:
            self._leave(self._agents[-1])
        super().stop()

    def _open(self) -> None:
        """Open node agents on nodes that have none, for as many workers as have something to do."""
        begun = sum(len(each.jobs) for each in self._agents)
        wanted = min(self.workers, len(self._queue) + begun)
        wanted -= sum(each.workers for each in self._agents)
        busy = {each.node.id for each in self._agents}
        for node in [node for node in self.nodes.ready if node.id not in busy]:
            workers = min(wanted, node.cores)
            if workers < 1 or not self.joined.check():
                return
            wanted -= workers
            spec, jobs, fresh = self.agent
            actor = self.joined.on(node.id, NodeAgent, cores=workers).remote(
                spec, jobs, workers, fresh=fresh
            )
            self._agents.append(
                _OpenAgent(
                    node=node,
                    actor=actor,
                    workers=workers,
                    awaited=actor.open.remote(),
                    opened_by=monotonic() + _OPENING,
                )
            )

    def _ask(self, each: _OpenAgent) -> None:
        """Give a node agent what it has workers for, and ask what it has come to."""
        jobs_to_go: list[TrialJob] = []
        while self._queue and len(each.jobs) < each.workers:
            job = self._next(each)
            each.jobs[job.trial.id] = job, monotonic() + job.time_limit + _NO_ANSWER
            each.scenes.add(job.trial.scene)
            jobs_to_go.append(job)
        if each.jobs:
            each.awaited = each.actor.work.remote(jobs_to_go)

    def _next(self, each: _OpenAgent) -> TrialJob:
        """Take a node agent's next job from the queue."""
        taken = {scene for other in self._agents for scene in other.scenes}
        place = next_place((job.trial for job in self._queue), own=each.scenes, taken=taken)
        job = self._queue[place]
        del self._queue[place]
        return job

    def _heard(self) -> list[_OpenAgent]:
        """Wait a moment; return node agents that have said something, or should have long ago."""
        pending = {each.awaited: each for each in self._agents if each.awaited is not None}
        if not pending:
            sleep(POLL)
            return []
        answered, _ = self.joined.ray.wait(list(pending), timeout=POLL)
        if answered:  # Whatever else is there by now.
            answered, _ = self.joined.ray.wait(list(pending), num_returns=len(pending), timeout=0)
        there = {*answered}
        return [each for each in pending.values() if each.awaited in there or each.is_late]

    def _look(self, each: _OpenAgent) -> Iterator[Finished]:
        """Take in what a node agent says, and yield jobs that have ended."""
        try:
            answer: Answer | None = self.joined.ray.get(each.awaited, timeout=POLL)
        except self.joined.ray.exceptions.RayError as error:
            self._leave(each)
            yield from self._lost(each, error)
            return
        each.awaited, each.is_open = None, True
        if answer is None:
            return
        each.node.strikes = 0
        with suppress(OSError):
            os.write(self.output.end.fileno(), answer.printed)
        job, _ = each.jobs.pop(answer.trial)
        yield Finished(job=job, result=_keep_log(answer, job), host=answer.host)

    def _lost(self, each: _OpenAgent, error: Exception) -> Iterator[Finished]:
        """Yield the ends of the jobs of a lost node agent: an error, if they were begun."""
        node = each.node
        if not each.is_open and each.is_late:
            node.cores = max(1, each.workers // 2)  # Somebody else has the others.
            return
        self.nodes.strike(node, error)
        jobs = [job for job, _ in each.jobs.values()]
        if isinstance(getattr(error, "cause", None), TrialError):  # No worker could begin one.
            self._queue.extendleft(reversed(jobs))
            self.nodes.refuse(node, error)
            return
        text = f"node {node.name}, or its workers' supervisor there, was lost"
        result = TrialResult(status="error", error_type="crashed", error_text=text)
        yield from (Finished(job=job, result=result) for job in jobs)

    def _leave(self, each: _OpenAgent) -> None:
        self._agents.remove(each)
        if self.joined.answers:
            with suppress(self.joined.ray.exceptions.RayError, ValueError):  # It is gone already.
                self.joined.ray.kill(each.actor, no_restart=True)


@dataclass(kw_only=True)
class Node:
    """A node that has cores to offer."""

    id: str
    name: str
    """For people: its host, and the first digits of its id."""
    cores: int
    stage: Literal["asked", "listing", "packing", "ready", "refused"]
    awaited: Any = None
    """Ray's reference to the answer to what it was last asked; None = to nothing."""
    strikes: int = 0
    rests_until: float = 0.0


@dataclass(eq=False)
class Nodes:
    """All nodes of the cluster, for one run."""

    joined: Joined
    spec: JobSpec
    """What nodes make ready."""
    outgoing: Outgoing
    """The files that they may lack."""
    question: Mapping[str, Any]
    """The arguments of `ray_node.facts`."""
    listener: Listener
    """Hears of nodes that are refused or lost."""

    def __post_init__(self) -> None:
        self._facts = there.facts(**self.question)
        self._nodes: dict[str, Node] = {}
        self._refused: dict[str, str] = {}  # Why, by id.
        self._pieces: dict[str, list[Any]] = {}  # References to them, by sha256 of their file.
        self._next_look = 0.0
        self._last_hope = monotonic()

    @property
    def ready(self) -> Iterator[Node]:
        """Nodes on which workers can be started."""
        now = monotonic()
        nodes = self._nodes.values()
        return (node for node in nodes if node.stage == "ready" and now >= node.rests_until)

    def look(self) -> None:
        """Take in what nodes have answered, which came and which are gone; wait for nothing.

        Raises:
            PrerequisiteError: all nodes are refused.
            TrialError: there has been none for a minute, or the head of the cluster is lost.
        """
        if monotonic() >= self._next_look:
            if self.joined.check():
                self._count()
            self._next_look = monotonic() + _LOOK
        pending = {each.awaited: each for each in self._nodes.values() if each.awaited is not None}
        if pending:
            answered, _ = self.joined.ray.wait(list(pending), num_returns=len(pending), timeout=0)
            for reference in answered:
                self._hear(pending[reference])
        if not any(each.stage == "packing" for each in self._nodes.values()):
            self._pieces.clear()
        self._check_hope()

    def strike(self, node: Node, error: Exception) -> None:
        """Note that nothing could be started on a node."""
        node.strikes += 1
        node.rests_until = monotonic() + _REST
        if node.strikes >= _STRIKES and node.stage != "refused":
            self._refuse(node, _reason_of(error))

    def refuse(self, node: Node, error: Exception) -> None:
        """Use a node no more, since workers cannot be kept alive there."""
        self._refuse(node, _reason_of(error))

    def tidy(self) -> None:
        """Have nodes remove what the run left there; wait some seconds at most."""
        ray, token = self.joined.ray, self.spec.token
        if not self.joined.answers:
            return
        pending = [self._ask(each, there.tidy, token) for each in self._nodes.values()]
        if pending:
            ray.wait(pending, num_returns=len(pending), timeout=_FAREWELL)

    def _count(self) -> None:
        """Ask nodes that are new; forget those that are gone."""
        alive = {
            each["NodeID"]: each
            for each in self.joined.ray.nodes()
            if each["Alive"] and each["Resources"].get("CPU", 0) >= 1
        }
        for name in [name for name in self._nodes if name not in alive]:
            self.listener.message(f"node {self._nodes.pop(name).name} is lost")
        for name, each in alive.items():
            if name not in self._nodes:
                node = Node(
                    id=name,
                    name=f"{clean(each['NodeManagerHostname'], at_most=60)} {name[:8]}",
                    cores=int(each["Resources"]["CPU"]),
                    stage="asked",
                )
                self._nodes[name] = node
            node = self._nodes[name]
            if node.stage == "asked" and node.awaited is None and monotonic() >= node.rests_until:
                node.awaited = self._ask(node, there.facts, **self.question)

    def _hear(self, node: Node) -> None:
        """Take in an answer, and ask what comes next."""
        reference, node.awaited = node.awaited, None
        try:
            answer = self.joined.ray.get(reference)
            if node.stage == "asked":
                if differences := _differences(answer, self._facts):
                    self._refuse(node, differences)
                    return
                node.stage = "listing"
                node.awaited = self._ask(node, there.lacking, self.spec.file_bundles)
            elif node.stage == "listing":
                node.stage = "packing"
                pieces = {sha256: self._cut(sha256) for sha256 in answer}
                node.awaited = self._ask(node, there.make_ready, self.spec, pieces)
            else:
                node.stage = "ready"
        except self.joined.ray.exceptions.RayError as error:
            if getattr(error, "cause", None) is not None:
                self._refuse(node, _reason_of(error))
                return
            # A process of Ray's is lost, or all of the node, which the next look will find missing.
            node.stage = "asked"
            self.strike(node, error)

    def _ask(self, node: Node, question: Any, *arguments: Any, **options: Any) -> Any:
        # What compiles kernels holds much memory: its process ends with it.
        once = question is there.make_ready
        return self.joined.on(node.id, question, cores=0, once=once).remote(*arguments, **options)

    def _cut(self, sha256: str) -> list[Any]:
        """Return references to the pieces of a file, which each node fetches once."""
        if sha256 not in self._pieces:
            with self.outgoing.sources[sha256].open("rb") as file:
                pieces = iter(lambda: file.read(_PIECE), b"")
                self._pieces[sha256] = [self.joined.ray.put(piece) for piece in pieces]
        return self._pieces[sha256]

    def _refuse(self, node: Node, reason: str) -> None:
        node.stage, node.awaited = "refused", None
        self._refused[node.id] = f"{node.name}: {reason}"
        self.listener.message(f"node {node.name} is refused: {reason}")

    def _check_hope(self) -> None:
        present: Sequence[Node] = tuple(self._nodes.values())
        if any(node.stage != "refused" for node in present):
            self._last_hope = monotonic()
        elif present:
            raise PrerequisiteError(
                f"no node of the cluster can be used: {self._refused[present[0].id]}"
                + (f" (and {len(present) - 1} more)" if len(present) > 1 else ""),
                fix=f"install nw-eval {self._facts['nw-eval']} there as it is here, under the same "
                "Python and libraries, on the same kind of processor",
            )
        elif monotonic() > self._last_hope + _PATIENCE:
            raise TrialError(
                f"the cluster has had no node with a core to offer for {_PATIENCE:.0f} s",
                fix="check `ray status`; --resume continues the run",
            )


def _reason_of(error: Exception) -> str:
    """Return what happened on a node, in one line."""
    cause: Any = getattr(error, "cause", None) or error
    if isinstance(cause, NwEvalError):
        return str(cause)
    lines = [line.strip() for line in str(cause).splitlines() if line.strip()]
    return clean(lines[-1] if lines else repr(cause), at_most=300)


def _differences(theirs: Mapping[str, str], ours: Mapping[str, str]) -> str:
    """Return in words what a node has otherwise than this machine; empty = nothing."""
    found = (
        f"{name} {clean(theirs.get(name, 'none'), at_most=80)}, here {ours.get(name, 'none')}"
        for name in sorted(set(theirs) | set(ours))
        if theirs.get(name) != ours.get(name)
    )
    return "; ".join(found)


def _keep_log(answer: Answer, job: TrialJob) -> TrialResult:
    """Write the log of a job where the head has planned it, and return its result.

    As on one machine, there is then the log of this attempt, or what was written of it until its
    process died, and none of the attempt before.

    Args:
        answer: what came back.
        job: as the head gave it out.

    Returns:
        The result, which says why if the log is lost.
    """
    if job.mcap is None:
        return answer.result
    partial = job.mcap.with_name(f"{job.mcap.name}.partial")
    try:
        _put(job.mcap, answer.log)
        _put(partial, answer.partial)
    except (OSError, StoreError) as error:
        return replace(answer.result, mcap_bytes=0, mcap_error=str(error))
    return answer.result


def _put(path: Path, data: bytes) -> None:
    if not data:
        path.unlink(missing_ok=True)
        return
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
