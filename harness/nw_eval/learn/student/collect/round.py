"""A round's trajectories: which there are, and the workers that drive those that are missing."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.engine.machine.cores import worker_count
from nw_eval.engine.machine.output import WorkerOutput
from nw_eval.engine.plan import default_time_limit
from nw_eval.engine.workers.local import LocalWorkers
from nw_eval.engine.workers.worker import WorkerStart
from nw_eval.learn.student.collect.drive import Pair
from nw_eval.learn.student.data.trajectory import read_trajectory
from nw_eval.rollout.confined.access import running_rules
from nw_eval.rollout.job import TrialJob
from nw_eval.suite.digest import digest_of
from nw_eval.suite.trials import Trial

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from nw_eval.catalogue import FoundScene
    from nw_eval.learn.student.config import StudentConfig
    from nw_eval.learn.student.data.trajectory import Trajectory
    from nw_eval.policies import Bundle
    from nw_eval.rollout.result import TrialResult

_WORKERS_LOG = "workers.log"


@dataclass(frozen=True, kw_only=True)
class Round:
    """A round's trajectories, each a trial of its own seed: no evaluation begins as one of them.

    Attributes:
        number: from 1.
        jobs: in the order in which they are learnt from.
    """

    number: int
    folder: Path
    jobs: tuple[TrialJob, ...]
    student: Bundle
    teacher: Bundle

    @property
    def missing(self) -> tuple[TrialJob, ...]:
        """The trajectories that no file holds yet, in the order in which to start them."""
        return tuple(job for job in self.jobs if job.mcap is not None and not job.mcap.exists())

    def read(self) -> Iterator[tuple[TrialJob, Trajectory]]:
        """Yield the trajectories that there are, in their order.

        Raises:
            StoreError: one is damaged.
        """
        for job in self.jobs:
            if job.mcap is not None and job.mcap.exists():
                yield job, read_trajectory(job.mcap)

    def drive(self, workers: int | None = None) -> Iterator[tuple[TrialJob, TrialResult] | None]:
        """Drive what is missing; yield each as it ends, and None now and then while none does.

        Whoever reads may stop reading at any time: workers are ended then.

        Args:
            workers: processes; one for each core if None.

        Raises:
            TrialError: no workers can be had.
        """
        jobs = self.missing
        if not jobs:
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        rules = running_rules(
            self.student,
            scenes=[job.scene for job in jobs],
            logs=self.folder,
            also=(self.teacher.folder, *self.teacher.files),
        )
        start = WorkerStart(rules=rules, renders=bool(self.student.card.splat_images))
        pair = Pair(student=self.student.reference, teacher=self.teacher.reference)
        output = WorkerOutput(self.folder.parent / _WORKERS_LOG)
        count = worker_count(workers, len(jobs))
        with LocalWorkers(count, start=start, run=pair, output=output) as staff:
            staff.submit(jobs)
            for done in staff.finished():
                yield None if done is None else (done.job, done.result)


def plan_round(
    number: int,
    config: StudentConfig,
    scenes: Sequence[FoundScene],
    folder: Path,
    *,
    student: Bundle,
    teacher: Bundle,
) -> Round:
    """Return a round's trajectories, planned: the same for the same config, whoever drives them.

    Args:
        number: from 1.
        config: of the training.
        scenes: that are driven in, one after the other.
        folder: where the trajectories go.
        student: as the round before has left it.
        teacher: drives a part of them.
    """
    count = config.trajectories
    # The teacher's are spread evenly over the round, and so over its scenes.
    share = config.taught_share(number)
    digest = digest_of(["student", number])
    jobs: list[TrialJob] = []
    for place in range(count):
        found = scenes[place % len(scenes)]
        teacher_drives = int((place // len(scenes) + 1) * share) > int(
            (place // len(scenes)) * share
        )
        driver = teacher if teacher_drives else student
        trial = Trial(
            suite=f"student-round-{number}",
            suite_digest=digest,
            suite_seed=config.seed,
            scene=found.scene.name,
            scene_digest=found.scene.digest,
            task=found.scene.task,
            index=place // len(scenes),
        )
        jobs.append(
            TrialJob(
                trial=trial,
                robot=teacher.card.robot,
                duration=config.duration,
                scene=found.reference,
                collision=found.collision,
                policy=driver.reference,
                policy_name=driver.name,
                checkpoint_digest=driver.checkpoint_digest,
                record="none",
                mcap=(folder / f"{trial.id}.npz").resolve(),
                time_limit=default_time_limit(config.duration),
            )
        )
    return Round(
        number=number, folder=folder.resolve(), jobs=tuple(jobs), student=student, teacher=teacher
    )
