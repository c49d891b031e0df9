"""Evaluating students: runs as `nw-eval run` makes them, each once."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nw_eval import api
from nw_eval.learn.studies.scores import Outcome
from nw_eval.policies import load_bundle
from nw_eval.results.journal import has_begun
from nw_eval.results.run_folder import RunFolder
from nw_eval.suite.dump import suite_yaml
from nw_eval.suite.model import new_suite

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from contextlib import AbstractContextManager
    from pathlib import Path

    from nw_eval.engine.listener import Listener
    from nw_eval.learn.studies.config import StudyConfig
    from nw_eval.learn.studies.folder import StudyFolder
    from nw_eval.learn.studies.plan import PlannedStudent


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
