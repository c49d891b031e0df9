"""Beginning a study, and taking one up again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.errors import UsageError
from nw_eval.learn.program.config import load_config
from nw_eval.learn.studies.evaluate import suite_of
from nw_eval.learn.studies.folder import StudyFolder
from nw_eval.learn.studies.plan import settled
from nw_eval.learn.studies.study import StudyRun

if TYPE_CHECKING:
    from collections.abc import Callable
    from contextlib import AbstractContextManager

    from nw_eval.engine.listener import Listener
    from nw_eval.learn.studies.kinds.kind import Kind

_RUNS = Path("runs")


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
        out: its folder; `runs/NAME` if None.
        resume: the folder of a study to go on with.
        say: takes a line for people.
        listening: makes what hears of one evaluation.
        workers: processes; one for each core if None.

    Raises:
        UsageError: what is wrong with the config, by file and line; there is no config, or no
            study to go on with; or one is there already.
        IncomparableError: the study to go on with is of another config.
        SceneError, PolicyError: scenes or teacher cannot be used.
        StoreError: the folder cannot be written.
    """
    if config is None and resume is None:
        raise UsageError("no config", fix="name one, or go on with a study: --resume FOLDER")
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
