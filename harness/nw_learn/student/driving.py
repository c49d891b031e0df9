"""A round of driving: in which scenes, which trajectories, and the workers that drive them."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from nw_base.digest import digest_of
from nw_base.errors import UsageError
from nw_base.plural import plural
from nw_base.trials import Trial
from nw_base.words import BLIND, KERNELS
from nw_eval.engine.listener import NullListener
from nw_eval.engine.local import LocalWorkers
from nw_eval.engine.machine import WorkerOutput, worker_count
from nw_eval.engine.plan import default_time_limit
from nw_eval.engine.prepare import build_splats, check_splats, open_backend, ready_scans
from nw_eval.engine.worker import WorkerStart
from nw_learn.progress import EVERY
from nw_learn.student.drive import Pair
from nw_learn.student.trajectory import read_trajectory
from nw_places.splits import split_of
from nw_sim.catalogue import FoundScene, references
from nw_sim.rollout.confined.access import running_rules
from nw_sim.rollout.job import TrialJob, kernels_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from nw_learn.student.config import StudentConfig
    from nw_learn.student.trajectory import Trajectory
    from nw_policies import Bundle
    from nw_policies.cards import Card
    from nw_sim.rollout.job import TrialResult

_WORKERS_LOG = "workers.log"

_ATTEMPTS = 2
"""A worker that the system ended is not the policy's fault; one that fails twice is left out."""


def training_scenes(patterns: Sequence[str]) -> tuple[FoundScene, ...]:
    """Return the scenes that patterns name, without those that evaluations are for.

    Raises:
        SceneError: a pattern matches nothing, or a scene cannot be opened.
        UsageError: nothing is left.
    """
    training = [each for each in references(patterns) if split_of(each[0]) != "eval"]
    if not training:
        raise UsageError(
            f"scenes: {', '.join(patterns)}: these are evaluation scenes, which may not be used "
            "for training",
            fix="name others, such as `split:train`",
        )
    return tuple(FoundScene.at(*each) for each in training)


def make_ready(scenes: Sequence[FoundScene], card: Card, say: Callable[[str], None]) -> None:
    """Compile and build what all workers need, once, before the first of them starts.

    Args:
        scenes: that will be driven in.
        card: the student's.
        say: takes a line for people.

    Raises:
        UsageError: the student must see a splat, and a scene has none.
        SceneError: a splat cannot be made.
    """
    opened, listener = [each.scene for each in scenes], _Told(say)
    check_splats(card, opened)
    ready_scans(opened, listener)
    sees = bool(card.splat_images)
    open_backend("cpu", listener, is_fenced=True, kernels=KERNELS if sees else BLIND)
    if sees:
        build_splats(opened, listener)


class _Told(NullListener):
    """Passes lines for people on, and every ten seconds which splat is being built."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._said_at = time.monotonic()

    def message(self, text: str) -> None:
        """Pass it on."""
        self._say(text)

    def scene(self, name: str, fraction: float) -> None:
        """Say it, if it is time."""
        if (now := time.monotonic()) - self._said_at >= EVERY:
            self._said_at = now
            self._say(f"builds the splats that are not there yet: {name} · {fraction:.0%} of it")


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
    for index in range(count):
        chosen = scenes[index % len(scenes)]
        teacher_drives = int((index // len(scenes) + 1) * share) > int(
            (index // len(scenes)) * share
        )
        driver = teacher if teacher_drives else student
        trial = Trial(
            suite=f"student-round-{number}",
            suite_digest=digest,
            suite_seed=config.seed,
            scene=chosen.scene.name,
            scene_digest=chosen.scene.digest,
            task=chosen.scene.task,
            index=index // len(scenes),
        )
        jobs.append(
            TrialJob(
                trial=trial,
                robot=teacher.card.robot,
                duration=config.duration,
                scene=chosen.reference,
                collision=chosen.collision,
                policy=driver.reference,
                policy_name=driver.name,
                checkpoint_digest=driver.checkpoint_digest,
                record="none",
                rendering=config.render,
                mcap=(folder / f"{trial.id}.npz").resolve(),
                time_limit=default_time_limit(config.duration),
            )
        )
    return Round(
        number=number, folder=folder.resolve(), jobs=tuple(jobs), student=student, teacher=teacher
    )


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
            workers: processes (default: one for each core).

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
        sees, job = bool(self.student.card.splat_images), jobs[0]
        kernels = kernels_of(job.robot, self.student.card, job.rendering.projection) if sees else ()
        start = WorkerStart(rules=rules, renders=kernels)
        pair = Pair(student=self.student.reference, teacher=self.teacher.reference)
        output = WorkerOutput(self.folder.parent / _WORKERS_LOG)
        count = worker_count(workers, len(jobs))
        with LocalWorkers(count, start=start, run=pair, output=output) as local:
            local.submit(jobs)
            for done in local.finished():
                yield None if done is None else (done.job, done.result)


class Driving:
    """The driving of one round's trajectories.

    Args:
        trajectories: of the round; those that there are already are not driven again.
        say: takes a line for people.
        most: bytes that the round may have: what comes after them in its order is not driven.
        workers: processes (default: one for each core).
    """

    def __init__(
        self,
        trajectories: Round,
        *,
        say: Callable[[str], None],
        most: int,
        workers: int | None = None,
    ) -> None:
        self._round = trajectories
        self._say = say
        self._most = most
        self._workers = workers
        self._failed: dict[str, str] = {}
        self._successes: list[float] = []
        self._began = self._spoke_at = time.monotonic()

    def run(self, is_ending: Callable[[], bool]) -> bool:
        """Drive what is missing; return whether that is done, or was ended before.

        Raises:
            TrialError: no workers can be had.
        """
        for _ in range(_ATTEMPTS):
            self._failed = {}
            for done in () if self._is_full else self._round.drive(self._workers):
                if is_ending():
                    return False
                if done is not None:
                    self._take(done[0].trial.id, done[1])
                    if self._is_full:
                        break
            if not self._failed:
                break
        for name, reason in self._failed.items():
            self._say(f"trajectory {name} is left out: {reason}")
        if self._successes:
            self._tell()
        return not is_ending()

    @property
    def _is_full(self) -> bool:
        """Whether the first trajectories of the round, without a hole, have all bytes."""
        total = 0
        for job in self._round.jobs:
            if job.mcap is None or not (job.mcap.exists() or job.trial.id in self._failed):
                break
            total += job.mcap.stat().st_size if job.mcap.exists() else 0
        return total >= self._most

    def _take(self, name: str, result: TrialResult) -> None:
        if result.status == "error":
            self._failed[name] = result.error_text
        else:
            self._successes.append(result.success)
        if time.monotonic() - self._spoke_at >= EVERY:
            self._tell()

    def _tell(self) -> None:
        """Say how far it is."""
        self._spoke_at = time.monotonic()
        count, all_ = len(self._successes), len(self._round.jobs)
        minutes = max(self._spoke_at - self._began, 1e-3) / 60.0
        left = len(self._round.missing)
        trajectories = plural(all_, "trajectory", "trajectories")
        words = [
            f"round {self._round.number}: {all_ - left} of {trajectories} driven",
            f"{count / minutes:.0f} a minute",
        ]
        if count:
            words += [
                f"{left * minutes / count:.0f} min left",
                f"success {sum(self._successes) / count:.3f}",
            ]
        self._say(" · ".join(words))
