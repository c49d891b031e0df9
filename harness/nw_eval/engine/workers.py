"""What runs the trials of a run.

It is processes of this machine, a cluster, or this very process, for debuggers, notebooks and
tests. There the bits are those of worker processes, but nothing stands between a policy and this
process. It is not confined, so it is for policies that one trusts. One that hangs is never `hung`,
since no process could end it, and one that ends its process ends this one. What it prints goes
where this process prints, and a `breakpoint()` in it works.
"""

from __future__ import annotations

import sys
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Self

from nw_eval.engine.pool import Finished, QueuedWorkers
from nw_gate.results.provenance import PACKAGES

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator, Sequence

    from nw_eval.engine.how import How
    from nw_eval.engine.listener import Listener
    from nw_eval.engine.plan import Plan
    from nw_eval.engine.pool import StartWorkers
    from nw_eval.engine.prepare import SplatBuilders
    from nw_eval.engine.ray_connection import Joined
    from nw_gate.results.run_folder import RunFolder
    from nw_policies import Bundle
    from nw_sim.rollout.job import TrialJob


@dataclass(frozen=True, kw_only=True)
class WorkerPool:
    """A pool of workers that can run trials."""

    workers: int | None
    """How many at a time; None = one for each core of this machine."""
    in_process: bool = False
    """Whether it is this process."""
    joined: Joined | None = None
    """The cluster that it is, if it is one."""

    @property
    def is_local(self) -> bool:
        """Whether it is processes of this machine, which need not wait for all splats."""
        return not self.in_process and self.joined is None

    @contextmanager
    def start_workers(
        self,
        plan: Plan,
        jobs: Sequence[TrialJob],
        folder: RunFolder,
        listener: Listener,
        builders: SplatBuilders,
    ) -> Generator[StartWorkers]:
        """Give what gets workers for the jobs of a plan inside the `with` block.

        Args:
            plan: the run's.
            jobs: of the plan.
            folder: the run's folder.
            listener: told of progress.
            builders: of the splats that processes of this machine do not wait for all.

        Raises:
            UsageError: what the run needs cannot be brought there.
        """
        if self.in_process:
            yield InProcess(plan.bundle)
        elif self.joined is not None:
            from nw_eval.engine.ray_workers import RayProcesses

            with RayProcesses(
                plan, jobs, folder, joined=self.joined, listener=listener
            ) as start_workers:
                yield start_workers
        else:
            from nw_eval.engine.local import LocalProcesses

            limit = plan.memory_limit
            yield LocalProcesses(jobs, folder, memory_limit=limit, builders=builders)


@contextmanager
def worker_pool(how: How) -> Generator[WorkerPool]:
    """Open a pool of workers that can run trials, before anything of a run is written.

    Raises:
        PrerequisiteError: Ray is not installed.
        UsageError: there is no such cluster.
    """
    if how.cluster is None:
        yield WorkerPool(workers=1 if how.in_process else how.workers, in_process=how.in_process)
        return
    from nw_eval.engine.ray_connection import joined

    with joined(how.cluster, cores=how.workers) as found:
        count = found.cores if how.workers is None else how.workers
        yield WorkerPool(workers=count, joined=found)


class InProcess:
    """Gets workers that are this process itself.

    Args:
        bundle: what the run's jobs call by its `reference`, so that it is not loaded again; a
            policy that is an object of Python's cannot be.
    """

    again = "in this process"

    def __init__(self, bundle: Bundle) -> None:
        self._bundle = bundle

    def __call__(self, count: int, *, fresh: bool) -> InProcessWorkers:  # noqa: ARG002 - one it is.
        """Return workers that share nothing with those before but what Python has imported."""
        return InProcessWorkers(self._bundle)


class InProcessWorkers(QueuedWorkers):
    """Runs a job when its result is waited for; a context manager.

    Ctrl-C and SIGTERM are heard by `engine.session` between two trials; the second one raises
    KeyboardInterrupt in the trial.

    Args:
        bundle: the policy of all jobs.
    """

    def __init__(self, bundle: Bundle) -> None:
        from nw_sim.rollout.library import Library  # It knows the simulator.

        super().__init__()
        self._bundle = bundle
        self._library = Library(known=(bundle,))

    def __enter__(self) -> Self:
        from nw_policies.line import trusting

        self._cleanup.enter_context(_one_thread())
        self._cleanup.enter_context(trusting())
        if self._bundle.code_sha256:
            self._cleanup.enter_context(_forgotten_afterwards(self._bundle.folder))
        return self

    def finished(self) -> Iterator[Finished | None]:
        """Run the queued jobs and yield their results.

        Raises:
            KeyboardInterrupt: Ctrl-C, where the first one is not handled.
        """
        from nw_sim.rollout.trial import run_trial

        while self._queue:
            job = self._queue.popleft()
            yield Finished(job=job, result=run_trial(job, library=self._library))


@contextmanager
def _one_thread() -> Generator[None]:
    """Let torch compute on one thread, as in a worker, and afterwards on as many as before.

    More threads change the last bits of an action. Where torch is imported later, adapters see to
    it themselves.
    """
    torch = sys.modules.get("torch")
    if torch is None:
        yield
        return
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


@contextmanager
def _forgotten_afterwards(folder: Path) -> Generator[None]:
    """Leave no module behind that a policy's folder brought in.

    The next run of it has the files as they are then, and its digest is that of them; and the next
    policy's module may have the same name.
    """
    root, before = folder.resolve(), set(sys.modules)
    try:
        yield
    finally:
        for name in [name for name in sys.modules if name not in before]:
            file = Path(getattr(sys.modules[name], "__file__", None) or "")
            is_own = file.suffix == ".py" and file.is_relative_to(root)
            # A card may lie above an environment: what is installed there is none of its code.
            if (
                is_own
                and "site-packages" not in file.parts
                and name.partition(".")[0] not in PACKAGES
            ):
                del sys.modules[name]
