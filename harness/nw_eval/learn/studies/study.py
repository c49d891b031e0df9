"""A study from its first student to its figure; it goes on where it was ended."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from nw_eval.learn.program.folder import TrainFolder
from nw_eval.learn.student.train import resume_student, train_student
from nw_eval.learn.studies.evaluate import evaluate, outcomes_of
from nw_eval.learn.studies.progress import StudyProgress
from nw_eval.learn.studies.write import write_page, write_scores
from nw_eval.plural import plural

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from contextlib import AbstractContextManager

    from nw_eval.engine.listener import Listener
    from nw_eval.learn.studies.folder import StudyFolder
    from nw_eval.learn.studies.kinds.kind import Kind
    from nw_eval.learn.studies.plan import PlannedStudent
    from nw_eval.learn.studies.scores import Outcome


@dataclass(frozen=True, kw_only=True)
class _Stage:
    """A student's training, or its evaluation after a round."""

    student: PlannedStudent
    round: int | None
    """None = the training."""

    @property
    def kind(self) -> str:
        return "trains" if self.round is None else "evaluates"


class StudyRun:
    """A study in its folder.

    Args:
        kind: of the study.
        folder: that has been begun.
        students: in their order.
        trials: of an evaluation in each scene.
        say: takes a line for people.
        listening: makes what hears of one evaluation.
        workers: processes; one for each core if None.
    """

    def __init__(
        self,
        kind: Kind,
        folder: StudyFolder,
        students: Sequence[PlannedStudent],
        *,
        trials: int,
        say: Callable[[str], None],
        listening: Callable[[], AbstractContextManager[Listener]],
        workers: int | None = None,
    ) -> None:
        self.kind, self.folder, self.students = kind, folder, tuple(students)
        self._trials = trials
        self._say, self._listening, self._workers = say, listening, workers

    def run(self) -> bool:
        """Train and evaluate what is missing, and write figure and tables after each evaluation.

        Returns:
            Whether all is done; if not, a signal came or a training's minutes are over.

        Raises:
            NwEvalError: as `train_student` and `api.run`; what was done stays.
        """
        stages = [
            _Stage(student=student, round=number)
            for student in self.students
            for number in (None, *student.rounds)
        ]
        done = [place for place, stage in enumerate(stages) if self._is_done(stage)]
        if done:
            self._say(f"study: {len(done)} of {len(stages)} are done already")
        progress = StudyProgress(self._say, [stage.kind for stage in stages], done=done)
        for place, stage in enumerate(stages):
            if place in done:
                continue
            progress.begin(place, _doing(stage))
            if not self._carry_out(stage):
                return False
            progress.end(place)
            if stage.round is not None:
                self.write()
        self.write()
        return True

    def write(self) -> None:
        """Write figure and tables of what there is so far.

        Raises:
            StoreError: rows are damaged, or a file cannot be written.
        """
        found = [each for student in self.students for each in self._outcomes(student)]
        scores = self.kind.scores(self.students, found)
        if not scores:
            return
        write_scores(self.folder.table, scores)
        write_page(self.folder.page, self.kind.tables(self.students, scores))
        self.kind.draw(self.folder.figure, self.students, scores)

    def _outcomes(self, student: PlannedStudent) -> list[Outcome]:
        return [
            outcome
            for number in student.rounds
            for outcome in outcomes_of(self.folder.run(student.name, number), student.name, number)
        ]

    def _is_done(self, stage: _Stage) -> bool:
        student = stage.student
        if stage.round is None:
            return self.folder.is_trained(student.name, student.config.rounds)
        run = self.folder.run(student.name, stage.round)
        found = outcomes_of(run, student.name, stage.round)
        return len(found) == self._trials * len(student.scenes)

    def _carry_out(self, stage: _Stage) -> bool:
        """Do a stage; return whether it has come to its end."""
        if stage.round is not None:
            return evaluate(
                self.folder,
                stage.student,
                stage.round,
                listening=self._listening,
                workers=self._workers,
            )
        return self._train(stage.student.name)

    def _train(self, name: str) -> bool:
        """Train a student, or what is missing of it; return whether it has come to its end."""
        folder = self.folder.training(name)
        if TrainFolder(folder).config.is_file():
            trained = resume_student(folder, say=self._say, workers=self._workers)
        else:
            config = self.folder.student_config(name)
            trained = train_student(config, folder, say=self._say, workers=self._workers)
        return trained.is_done


def _doing(stage: _Stage) -> str:
    student, config = stage.student, stage.student.config
    if stage.round is None:
        trajectories = plural(config.trajectories, "trajectory", "trajectories")
        rounds = plural(config.rounds, "round")
        return f"trains {student.name}: {rounds} of {trajectories}, {config.budget.steps:,} samples"
    scenes = plural(len(student.scenes), "scene")
    return f"evaluates {student.name} after round {stage.round} in {scenes}"
