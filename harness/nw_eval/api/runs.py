"""Running: a suite through its trials."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.api.plans import plan
from nw_eval.api.reports import RunReport, report
from nw_eval.errors import UsageError
from nw_eval.traceback_file import TracebackIn

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nw_eval.engine.listener import Listener
    from nw_eval.results.run_folder import RunFolder
    from nw_eval.rollout.job import Backend, Record
    from nw_eval.scenes.terrain.options import Collision
    from nw_eval.suite import Suite


def run(
    suite: str | Path | None,
    *,
    robot: str | None = None,
    policy: str | None = None,
    checkpoint: Path | None = None,
    trials: int | None = None,
    scenes: Sequence[str] = (),
    seed: int | None = None,
    workers: int | None = None,
    out: Path | None = None,
    resume: Path | None = None,
    record: Record | None = None,
    time_limit: float | None = None,
    render: Backend = "cpu",
    allow_code: bool = False,
    collision: Collision = "terrain",
    listener: Listener | None = None,
) -> RunReport:
    """Roll a checkpoint out through a suite, write the evidence, and judge it.

    Args:
        suite: a suite file or the name of a shipped one; None only with `resume`.
        robot: in place of the suite's own; its trials are others then.
        policy: a bundle's name, folder or card; the suite's own if None.
        checkpoint: weights to use with the card.
        trials: per scene; the suite's own number if None.
        scenes: globs; only scenes that match one of them.
        seed: in place of the suite's own: another panel of starts, so other trials.
        workers: processes; one for each core if None.
        out: the run's folder; a new one in `reports/` if None.
        resume: the folder of an interrupted run, whose finished trials are kept.
        record: whose camera images the logs keep; the suite's own choice if None.
        time_limit: wall seconds after which a trial counts as hung.
        render: the splat backend.
        allow_code: whether Python code that the card names may be imported.
        collision: how scan meshes collide: as compiled terrain, or by their own triangles.
        listener: hears of progress.

    Raises:
        UsageError, SuiteError, SceneError, PolicyError: nothing was run.
        IncomparableError: the run to resume was made under something else.
        StoreError: results cannot be written; those that were written stay.
    """
    from nw_eval.api.saved_run import settings_of
    from nw_eval.engine import session

    if workers is not None and workers < 1:
        raise UsageError(f"--workers {workers}", fix="give at least 1")
    chosen: str | Path | Suite | None = suite
    card: Path | None = None
    if resume is not None:
        if out is not None:
            raise UsageError("--out and --resume exclude each other", fix="drop --out")
        settings = settings_of(resume)
        asked = settings.suite
        chosen = suite or asked
        robot = robot or asked.robot
        card = None if policy else settings.card
        policy = policy or asked.policy
        checkpoint = checkpoint or settings.checkpoint
        trials = trials or asked.trials
        scenes = scenes or settings.scenes
        seed = asked.seed if seed is None else seed
        record = record or settings.record
        collision = settings.collision
    if chosen is None:
        raise UsageError("no suite", fix="name one, such as `nw-eval run hurdles`")
    made = plan(
        chosen,
        robot=robot,
        policy=policy,
        card=card,
        checkpoint=checkpoint,
        trials=trials,
        scenes=scenes,
        seed=seed,
        record=record,
        allow_code=allow_code,
        collision=collision,
    )
    return judged(
        session.run(
            made,
            workers=workers,
            out=out,
            resume=resume,
            time_limit=time_limit,
            render=render,
            command=tuple(sys.argv),
            listener=listener,
        )
    )


def judged(folder: RunFolder) -> RunReport:
    """Judge a run that has just ended.

    Raises:
        StoreError: its folder was removed, or the report cannot be written.
    """
    from nw_eval.engine.workers.presence import Presence

    with TracebackIn(folder.path):
        judged = report(folder.path)
    # Writing a report into a folder that was removed makes it anew.
    Presence(folder.journal).check()
    return judged
