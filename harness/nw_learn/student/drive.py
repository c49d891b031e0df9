"""One trajectory in a worker: a trial as every other, with a watcher in place of its log."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

from nw_base.errors import is_interrupt
from nw_sim.rollout.job import TrialResult

if TYPE_CHECKING:
    from nw_sim.rollout.job import TrialJob
    from nw_sim.rollout.library import Library

_library: Library | None = None


@dataclass(frozen=True, kw_only=True)
class Pair:
    """Who looks on in every trajectory of a round, one of whom drives; what `load_bundle` takes."""

    student: str
    teacher: str

    def __call__(self, job: TrialJob) -> TrialResult:
        """Drive a trajectory and write it where the job's log would lie.

        Whatever fails is a result with status `error`, as of every trial, and writes nothing.
        """
        # Here and not above: a worker that is only being started needs none of it.
        from nw_sim.rollout.library import Library
        from nw_sim.rollout.trial import failed

        global _library  # noqa: PLW0603 - one cache a process is the point.
        if _library is None:
            _library = Library()
        began = perf_counter()
        try:
            result = self._drive(job, _library)
        except BaseException as error:
            if is_interrupt(error):
                raise
            result = failed(TrialResult(status="error"), error)
        return replace(result, wall_seconds=perf_counter() - began)

    def _drive(self, job: TrialJob, library: Library) -> TrialResult:
        from nw_learn.student.trajectory import Watcher
        from nw_sim.rollout.job import StageClock
        from nw_sim.rollout.opening import open_trial
        from nw_sim.rollout.trial import ended

        assert job.mcap is not None, "that is where the trajectory goes"
        clock = StageClock()
        with clock("setup"):
            trial = open_trial(job, library, clock)
        with trial:
            watcher = Watcher(
                trial,
                library,
                student=library.bundle(self.student, None),
                teacher=library.bundle(self.teacher, None),
            )
            trial.cleanup.callback(watcher.close)
            result = ended(trial, trial.episode.run(watcher))
            path = Path(job.mcap)
            watcher.trajectory(result.success).write(path)
        return replace(result, wall=clock.stages, mcap_bytes=path.stat().st_size)
