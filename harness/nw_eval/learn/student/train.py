"""DAgger: rounds of driving and learning, which go on where they were ended."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from nw_eval.cards.load import card_of
from nw_eval.errors import IncomparableError, StoreError, UsageError
from nw_eval.learn.config import device_of, load_config, one_thread
from nw_eval.learn.curve import Curve
from nw_eval.learn.folder import TrainFolder
from nw_eval.learn.progress import Keeper, Trained, TrainingProgress
from nw_eval.learn.student.card import (
    BODY,
    ENCODER_FILE,
    NETWORK_FILE,
    check_teacher,
    student_card,
)
from nw_eval.learn.student.config import NOTHING, StudentConfig
from nw_eval.learn.student.dataset import Dataset
from nw_eval.learn.student.driving import Driving, Round, make_ready, plan_round, training_scenes
from nw_eval.learn.student.fit import Learner
from nw_eval.learn.student.network import write_policy
from nw_eval.policies import load_bundle
from nw_eval.rollout.confined.vetting import vet_bundle
from nw_eval.sensors import check_card

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from nw_eval.policies import Bundle

_ROW_EVERY = 50
"""Steps of the optimiser from one row of the curve to the next."""
_SMOOTH = 0.98
"""Share of the loss before in the smoothed one that the curve shows."""
_GIB = 2**30


def train_student(
    config: Path, out: Path, *, say: Callable[[str], None], workers: int | None = None
) -> Trained:
    """Train a student.

    Args:
        config: the file of a `StudentConfig`.
        out: the folder to make.
        say: takes lines of progress.
        workers: processes that drive; one for each core if None.

    Raises:
        UsageError: the config has problems, or a training is in the folder already.
        NwEvalError: as `StudentTraining` and its `run`.
    """
    settings = load_config(config, StudentConfig)
    folder = TrainFolder.begin(out, config)
    return StudentTraining(settings, folder, say=say, workers=workers).run()


def resume_student(
    folder: Path, *, say: Callable[[str], None], workers: int | None = None
) -> Trained:
    """Go on with a training where its last state is; its curve is an uninterrupted one's.

    Raises:
        UsageError: no training is in the folder.
        NwEvalError: as `StudentTraining` and its `run`.
    """
    there = TrainFolder.resume(folder)
    settings = load_config(there.config, StudentConfig)
    return StudentTraining(settings, there, say=say, workers=workers).run()


class StudentTraining:
    """A training, from its first round or from where it was ended.

    Args:
        config: checked.
        folder: of the training, with its state if it goes on.
        say: takes a line for people.
        workers: processes that drive; one for each core if None.

    Raises:
        PolicyError: the teacher cannot be used.
        SceneError, UsageError: the scenes cannot, or the teacher does not act at 50 Hz.
        PrerequisiteError: there is no such device, or nothing to export a network with.
        IncomparableError: the folder's state is of another config or teacher.
    """

    def __init__(
        self,
        config: StudentConfig,
        folder: TrainFolder,
        *,
        say: Callable[[str], None],
        workers: int | None = None,
    ) -> None:
        one_thread()
        self._config, self._folder, self._say, self._workers = config, folder, say, workers
        teacher = load_bundle(config.teacher)
        check_teacher(teacher.card)
        self._teacher = vet_bundle(teacher, teacher.card.robot)
        self._scenes = training_scenes(config.scenes)
        self._learner = Learner(
            config, proprio=body_size(config, teacher), device=device_of(config.device)
        )
        self._round, self._step, self._samples = 1, 0, 0
        self._loss = 0.0
        self._dataset = Dataset(
            cameras=config.sees.cameras, frames=config.sees.frames, chunk=config.network.chunk
        )
        if (state := folder.load_state()) is None:
            if config.start != NOTHING:
                self._learner.begin(self._start())
            self._write_policies(0)
        else:
            self._restore(state)
        untrained = load_bundle(self.policy(0))
        make_ready(self._scenes, vet_bundle(untrained, untrained.card.robot).card, say)
        self._curve = Curve(
            folder.path,
            upto=None if state is None else self._samples,
            counts="samples",
            say=say,
        )

    def _start(self) -> Path:
        """Return the file of the network to begin with.

        Raises:
            UsageError: there is none.
        """
        path = self._config.base / self._config.start
        if not path.is_file():
            raise UsageError(f"start: no file {path}", fix="name a .pt file of a training")
        return path

    def policy(self, number: int) -> Path:
        """Return the folder of the policy that a round has left; 0 = untrained."""
        return self._folder.path / "policies" / f"round-{number}"

    def run(self) -> Trained:
        """Train until the budget is used up, the minutes are over or a signal comes.

        Raises:
            StoreError: a file cannot be written, or a trajectory is damaged.
            TrialError: no workers can be had.
        """
        budget = self._config.budget
        self._progress = TrainingProgress(
            self._say,
            steps=budget.steps,
            first=self._samples,
            minutes=budget.minutes,
            what="samples",
        )
        keep = self._config.keep_every
        with Keeper(self._folder, self._curve, keep_every=keep, first=self._samples) as keeper:
            self._keeper = keeper
            for number in range(1, self._config.rounds + 1):
                trajectories = self._planned(number)
                is_over = number < self._round
                self._progress.leave()
                if not (is_over or self._drive(trajectories)):
                    break
                figures = self._take(trajectories)
                if is_over:
                    continue
                self._progress.back(self._samples, times=self._config.rounds - number)
                if not self._learn(figures):
                    break
                self._write_policies(number)
                self._round, self._step = number + 1, 0
                keeper.after(self._samples, self.state, is_last=True)
            is_done = self._round > self._config.rounds
            if not is_done:
                keeper.after(self._samples, self.state, is_last=True)
            return self._ended(is_done=is_done)

    def state(self) -> dict[str, Any]:
        """Return everything to go on with; trajectories are files of their own."""
        return {
            "config": self._config.digest,
            "teacher": self._teacher.digest,
            "round": self._round,
            "step": self._step,
            "samples": self._samples,
            "loss": self._loss,
            **self._learner.state(),
        }

    def _ended(self, *, is_done: bool) -> Trained:
        return Trained(
            program="student",
            folder=self._folder.path,
            policy=self.policy(self._round - 1),
            step=self._samples,
            is_done=is_done,
            is_interrupted=self._keeper.is_interrupted,
        )

    def _restore(self, state: dict[str, Any]) -> None:
        for name, ours in (("config", self._config.digest), ("teacher", self._teacher.digest)):
            if state.get(name) != ours:
                raise IncomparableError(
                    f"{self._folder.path} is of another {name}: {str(state.get(name))[:8]}, here "
                    f"it is {ours[:8]}",
                    fix="train in a new folder, or restore what it began with",
                )
        try:
            self._round, self._step = int(state["round"]), int(state["step"])
            self._samples, self._loss = int(state["samples"]), float(state["loss"])
            self._learner.restore(state)
        except (KeyError, TypeError, AttributeError, ValueError, RuntimeError) as error:
            raise StoreError(
                f"{self._folder.state} is no state of this training: {error!r}",
                fix="train in a new folder",
            ) from None

    def _planned(self, number: int) -> Round:
        return plan_round(
            number,
            self._config,
            self._scenes,
            self._folder.path / "trajectories" / f"round-{number}",
            student=load_bundle(self.policy(number - 1)),
            teacher=self._teacher,
        )

    def _drive(self, trajectories: Round) -> bool:
        """Drive what is missing of a round; return whether that is done."""
        most = int(self._config.dataset_gib * _GIB) - self._dataset.nbytes
        driving = Driving(trajectories, say=self._say, most=most, workers=self._workers)
        return driving.run(lambda: self._is_ending)

    def _take(self, trajectories: Round) -> dict[str, float]:
        """Take a round's trajectories into the dataset; return what they came to."""
        most = int(self._config.dataset_gib * _GIB)
        successes: dict[str, list[float]] = {}
        for job, one in trajectories.read():
            if self._dataset.nbytes >= most:
                self._say(
                    f"the dataset has {self._config.dataset_gib:g} GiB: the remaining samples "
                    "are left out"
                )
                break
            self._dataset.add(one)
            for group in ("all", job.trial.task):
                successes.setdefault(group, []).append(one.success)
        figures = {f"driving/{group}": sum(all_) / len(all_) for group, all_ in successes.items()}
        return figures | {
            "trajectories/so far": float(len(self._dataset.trajectories)),
            "control steps/so far": float(self._dataset.steps),
        }

    def _learn(self, figures: dict[str, float]) -> bool:
        """Learn until the round's share of the budget is used up; return whether it is."""
        config, number, learner = self._config, self._round, self._learner
        first, last = (config.budget.steps * n // config.rounds for n in (number - 1, number))
        if number == 1 and self._step == 0 and config.start == NOTHING:
            learner.normalise(self._dataset.moments())
        success = figures.get("driving/all", 0.0)
        while self._samples < last:
            if self._is_ending:
                return False
            done = max(self._samples - first, 0) / max(last - first, 1)
            found = learner.step(self._dataset, number=number, step=self._step, done=done)
            self._step += 1
            self._samples += int(found["samples"])
            loss = found["loss"]
            self._loss = loss if self._step == 1 else _SMOOTH * self._loss + (1 - _SMOOTH) * loss
            if self._step == 1 or self._step % _ROW_EVERY == 0 or self._samples >= last:
                row = {"learning/loss": self._loss, "round/number": float(number)}
                self._curve.append(self._samples, row | (figures if self._step == 1 else {}))
            self._progress.update(
                self._samples,
                f"round {number} of {config.rounds}",
                {"loss": self._loss, "driving": success},
            )
            self._keeper.after(self._samples, self.state)
        return True

    @property
    def _is_ending(self) -> bool:
        return self._keeper.is_interrupted or self._progress.is_time_up

    def _write_policies(self, number: int) -> None:
        """Write the student as it is, and with the mean image for good."""
        network, teacher = self._learner.network, self._teacher.card
        for is_blind in (False, True):
            folder = self.policy(number)
            folder = folder.with_name(f"{folder.name}-frozen") if is_blind else folder
            write_policy(folder, network, self._config, teacher, is_blind=is_blind)


def body_size(config: StudentConfig, teacher: Bundle) -> int:
    """Return how many numbers of its body a student is told."""
    digests = {NETWORK_FILE: "0" * 64, ENCODER_FILE: "0" * 64}
    card = card_of(student_card(config.name, config.sees, teacher.card, sha256=digests))
    sizes = {spec.name: spec.shape[0] for spec in check_card(card)}
    return sum(sizes[name] for name in BODY)
