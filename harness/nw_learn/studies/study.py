"""A study from its first student to its figure; it goes on where it was ended.

Students are evaluated by runs as `nw-eval run` makes them, each once.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from nw_base.errors import IncomparableError, UsageError
from nw_base.files.cache import atomic_path
from nw_base.plural import plural
from nw_eval import api
from nw_eval.suite.load import suite_yaml
from nw_eval.suite.model import new_suite
from nw_gate.results.journal import has_begun
from nw_gate.results.run_folder import RunFolder
from nw_learn.config import load_config
from nw_learn.folder import TrainFolder
from nw_learn.student.card import card_text as yaml_text
from nw_learn.student.train import resume_student, train_student
from nw_learn.studies.plan import StudyConfig, settled
from nw_learn.studies.scores import Outcome, write_page, write_scores
from nw_policies import load_bundle
from nw_policies.cards.load import CARD_FILE

if TYPE_CHECKING:
    from collections.abc import Iterable
    from contextlib import AbstractContextManager

    from nw_eval.engine.listener import Listener
    from nw_learn.studies.kinds import Kind
    from nw_learn.studies.plan import PlannedStudent

_RUNS = Path("runs")

C = TypeVar("C", bound=StudyConfig)

_MINUTE = 60.0


def open_study(
    kind: Kind,
    config: Path | None,
    *,
    out: Path | None,
    resume: Path | None,
    say: Callable[[str], None],
    listening: Callable[[], AbstractContextManager[Listener]],
    workers: int | None = None,
) -> StudyRun:
    """Begin a study, or take one up again.

    Args:
        kind: of the study.
        config: its file; None only with `resume`.
        out: its folder (default: `runs/NAME`).
        resume: the folder of a study to go on with.
        say: takes a line for people.
        listening: makes the listener of one evaluation.
        workers: processes (default: one for each core).

    Raises:
        UsageError: what is wrong with the config, by file and line; there is no config, or no
            study to go on with; or one is there already.
        IncomparableError: the study to go on with is of another config.
        SceneError, PolicyError: scenes or teacher cannot be used.
        StoreError: the folder cannot be written.
    """
    if config is None and resume is None:
        raise UsageError("no config", fix="name one, or resume a study: --resume FOLDER")
    if out is not None and resume is not None:
        raise UsageError("--out and --resume exclude each other", fix="drop --out")
    settings = None if config is None else settled(load_config(config, kind.config))
    if resume is not None:
        folder = StudyFolder(resume)
        settings = folder.saved(kind.config, settings)
        students = kind.students(settings)
    else:
        assert settings is not None
        folder = StudyFolder(out or _RUNS / settings.name)
        students = kind.students(settings)
        folder.begin(settings, students, suite_of(settings, students))
    return StudyRun(
        kind,
        folder,
        students,
        trials=settings.evaluation.trials,
        say=say,
        listening=listening,
        workers=workers,
    )


class StudyRun:
    """A study in its folder.

    Args:
        kind: of the study.
        folder: that has been begun.
        students: in their order.
        trials: of an evaluation in each scene.
        say: takes a line for people.
        listening: makes the listener of one evaluation.
        workers: processes (default: one for each core).
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
        done = [index for index, stage in enumerate(stages) if self._is_done(stage)]
        if done:
            self._say(f"study: {len(done)} of {len(stages)} are done already")
        progress = StudyProgress(self._say, [stage.kind for stage in stages], done=done)
        for index, stage in enumerate(stages):
            if index in done:
                continue
            progress.begin(index, _doing(stage))
            if not self._carry_out(stage):
                return False
            progress.end(index)
            if stage.round is not None:
                self.write()
        self.write()
        return True

    def write(self) -> None:
        """Write figure and tables of what there is so far.

        Raises:
            StoreError: rows are damaged, or a file cannot be written.
        """
        outcomes = [each for student in self.students for each in self._outcomes(student)]
        scores = self.kind.scores(self.students, outcomes)
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
        outcomes = outcomes_of(run, student.name, stage.round)
        return len(outcomes) == self._trials * len(student.scenes)

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


@dataclass(frozen=True, kw_only=True)
class _Stage:
    """A student's training, or its evaluation after a round."""

    student: PlannedStudent
    round: int | None
    """None = the training."""

    @property
    def kind(self) -> str:
        return "trains" if self.round is None else "evaluates"


def _doing(stage: _Stage) -> str:
    student, config = stage.student, stage.student.config
    if stage.round is None:
        trajectories = plural(config.trajectories, "trajectory", "trajectories")
        rounds = plural(config.rounds, "round")
        return f"trains {student.name}: {rounds} of {trajectories}, {config.budget.steps:,} samples"
    scenes = plural(len(student.scenes), "scene")
    return f"evaluates {student.name} after round {stage.round} in {scenes}"


class StudyFolder:
    """A study's folder.

    config.yaml                  as the study was begun, its scenes by name
    suite.yaml                   of all evaluations
    students/NAME.yaml           the student's config
    students/NAME/               its training, with its curve
    runs/NAME-round-N/           its evaluation after a round
    figure.png, table.parquet, table.md
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def begin(self, config: StudyConfig, students: Sequence[PlannedStudent], suite: str) -> None:
        """Make the folder of a new study; its config comes last, so that it is whole or none.

        Raises:
            UsageError: a study is in it already.
            StoreError: it cannot be written.
        """
        if self.config.exists():
            raise UsageError(
                f"{self.path} holds a study already",
                fix=f"resume it with --resume {self.path}, or choose another --out",
            )
        for student in students:
            fields = student.config.model_dump(mode="json", by_alias=True)
            _write(self.student_config(student.name), yaml_text(fields))
        _write(self.suite, suite)
        _write(self.config, yaml_text(config.fields))

    def saved(self, kind: type[C], config: C | None) -> C:
        """Return the config that the study was begun with.

        Args:
            kind: of the config.
            config: what it should be, settled, if that is known.

        Raises:
            UsageError: no study is in the folder, or one of another kind.
            IncomparableError: it is of another config.
        """
        if not self.config.is_file():
            raise UsageError(f"no study in {self.path}", fix="name a folder with a config.yaml")
        ours = load_config(self.config, kind)
        if config is not None and ours.digest != config.digest:
            raise IncomparableError(
                f"{self.path} is of another config: {ours.digest[:8]}, here it is "
                f"{config.digest[:8]}",
                fix="drop the config, or give another --out",
            )
        return ours

    @property
    def config(self) -> Path:
        """The copy of the study's config."""
        return self.path / "config.yaml"

    @property
    def suite(self) -> Path:
        """The suite of all evaluations."""
        return self.path / "suite.yaml"

    @property
    def figure(self) -> Path:
        """The study's figure."""
        return self.path / "figure.png"

    @property
    def table(self) -> Path:
        """The numbers of the figure."""
        return self.path / "table.parquet"

    @property
    def page(self) -> Path:
        """The same for people."""
        return self.path / "table.md"

    def student_config(self, name: str) -> Path:
        """Return where a student's config is."""
        return self.path / "students" / f"{name}.yaml"

    def training(self, name: str) -> Path:
        """Return the folder of a student's training."""
        return self.path / "students" / name

    def policy(self, name: str, number: int) -> Path:
        """Return the folder of the policy that a student's round leaves."""
        return self.training(name) / "policies" / f"round-{number}"

    def is_trained(self, name: str, rounds: int) -> bool:
        """Say whether all rounds of a student have left their policy."""
        return (self.policy(name, rounds) / CARD_FILE).is_file()

    def run(self, name: str, number: int) -> Path:
        """Return the folder of the evaluation of a student after a round."""
        return self.path / "runs" / f"{name}-round-{number}"


def _write(path: Path, text: str) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def suite_of(config: StudyConfig, students: Iterable[PlannedStudent]) -> str:
    """Return the suite of all evaluations of a study, as a file's text.

    Raises:
        PolicyError: the teacher cannot be used.
    """
    planned = list(students)
    teacher = planned[0].config.teacher
    scenes = dict.fromkeys(scene.reference for each in planned for scene in each.scenes)
    trials = config.evaluation
    suite = {
        "nw-eval": 1,
        "name": config.name,
        "robot": load_bundle(teacher).card.robot,
        "policy": teacher,
        "trials": trials.trials,
        "seed": trials.seed,
        "episode": {"duration": trials.duration},
        "scenes": list(scenes),
        "render": planned[0].config.render.model_dump(),
        "record": "none",
    }
    return suite_yaml(new_suite(suite))


def evaluate(
    folder: StudyFolder,
    student: PlannedStudent,
    number: int,
    *,
    listening: Callable[[], AbstractContextManager[Listener]],
    workers: int | None,
) -> bool:
    """Run what is missing of a student's evaluation after a round; return whether all is there.

    Raises:
        StoreError: results cannot be written; those that were written stay.
        PolicyError, SceneError, PrerequisiteError, IncomparableError: as `api.run`.
    """
    out = folder.run(student.name, number)
    has_rows = has_begun(RunFolder(path=out).journal)
    with listening() as listener:
        report = api.run(
            None if has_rows else folder.suite,
            policy=None if has_rows else str(folder.policy(student.name, number).resolve()),
            scenes=None if has_rows else tuple(each.name for each in student.scenes),
            out=None if has_rows else out,
            resume=out if has_rows else None,
            workers=workers,
            listener=listener,
        )
    return not report.interrupted


def outcomes_of(run: Path, student: str, number: int) -> tuple[Outcome, ...]:
    """Return what an evaluation came to so far; nothing where none has begun.

    Raises:
        StoreError: its rows are damaged.
    """
    if not has_begun(RunFolder(path=run).journal):
        return ()
    rows = api.read_rows(run)
    return tuple(
        Outcome(
            student=student,
            round=number,
            scene=str(scene),
            trial=str(trial),
            success=None if success is None or success != success else float(success),  # noqa: PLR0124 - NaN.
        )
        for scene, trial, success in zip(
            rows["scene"], rows["trial_id"], rows["success"], strict=True
        )
    )


class StudyProgress:
    """Says which stage begins. The time left is estimated from earlier stages of its kind.

    Args:
        say: takes a line.
        kinds: of all stages in their order, such as `trains`.
        done: stages that an earlier process has done.
        clock: seconds, never going back.
    """

    def __init__(
        self,
        say: Callable[[str], None],
        kinds: Sequence[str],
        *,
        done: Sequence[int] = (),
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._say, self._kinds, self._clock = say, kinds, clock
        self._left = [index for index in range(len(kinds)) if index not in set(done)]
        self._took: dict[str, list[float]] = {}
        self._began = self._stage_began = clock()

    def begin(self, index: int, doing: str) -> None:
        """Say that a stage begins."""
        self._stage_began = self._clock()
        words = [f"study: {index + 1} of {len(self._kinds)}", doing]
        if self._took:
            words.append(f"{_minutes(self._stage_began - self._began)} so far")
        left = self._seconds_left()
        if left is not None:
            words.append(f"about {_minutes(left)} left")
        self._say(" · ".join(words))

    def end(self, index: int) -> None:
        """Take it that a stage has ended."""
        self._took.setdefault(self._kinds[index], []).append(self._clock() - self._stage_began)
        self._left.remove(index)

    def _seconds_left(self) -> float | None:
        """Return what is left; None while a kind of stage is left that none has been done of."""
        kinds = Counter(self._kinds[place] for place in self._left)
        if not kinds or not set(kinds) <= set(self._took):
            return None
        return sum(
            count * sum(self._took[kind]) / len(self._took[kind]) for kind, count in kinds.items()
        )


def _minutes(seconds: float) -> str:
    if seconds < _MINUTE:
        return f"{seconds:.0f} s"
    minutes = seconds / _MINUTE
    return f"{minutes:.0f} min" if minutes < 120.0 else f"{minutes / 60.0:.1f} h"
