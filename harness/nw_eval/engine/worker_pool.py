"""Where a run's trials run: in processes of this machine, in this very one, or on a cluster."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from nw_eval.engine.local import LocalProcesses

if TYPE_CHECKING:
    from collections.abc import Generator, Sequence

    from nw_eval.engine.building import SplatBuilders
    from nw_eval.engine.listener import Listener
    from nw_eval.engine.plan import Plan
    from nw_eval.engine.ray_connection import Joined
    from nw_eval.engine.workers import StartWorkers
    from nw_eval.results.run_folder import RunFolder
    from nw_eval.rollout.job import TrialJob


@dataclass(frozen=True, kw_only=True)
class WorkerPool:
    """A pool of workers that can run trials."""

    workers: int | None
    """How many at a time; None = one for each core of this machine."""
    in_process: bool = False
    """Whether it is this process: see `engine.in_process`."""
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
            plan: of the run.
            jobs: of the plan.
            folder: of the run.
            listener: told of progress.
            builders: of the splats that processes of this machine do not wait for all.

        Raises:
            UsageError: what the run needs cannot be brought there.
        """
        if self.in_process:
            from nw_eval.engine.in_process import InProcess  # It knows the simulator.

            yield InProcess(plan.bundle)
        elif self.joined is not None:
            from nw_eval.engine.ray_workers import RayProcesses

            with RayProcesses(
                plan, jobs, folder, joined=self.joined, listener=listener
            ) as start_workers:
                yield start_workers
        else:
            limit = plan.memory_limit
            yield LocalProcesses(jobs, folder, memory_limit=limit, builders=builders)


@contextmanager
def worker_pool(
    *, workers: int | None, in_process: bool, cluster: str | None
) -> Generator[WorkerPool]:
    """Open a pool of workers that can run trials, before anything of a run is written.

    Args:
        workers: how many trials at a time; one for each core if None.
        in_process: whether it is this process.
        cluster: the address of a Ray cluster; None = this machine.

    Raises:
        PrerequisiteError: Ray is not installed.
        UsageError: there is no such cluster.
    """
    if cluster is None:
        yield WorkerPool(workers=1 if in_process else workers, in_process=in_process)
        return
    from nw_eval.engine.ray_connection import joined

    with joined(cluster, cores=workers) as found:
        yield WorkerPool(workers=found.cores if workers is None else workers, joined=found)
