"""One run from its folder to its rows: provenance first, then trials, then the Parquet file."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

from nw_eval.cache import atomic_path
from nw_eval.catalogue.find import TRIANGLES
from nw_eval.confinement import Fence, offered
from nw_eval.engine.listener import Listener, Silence
from nw_eval.engine.machine.cores import default_workers
from nw_eval.engine.machine.cpu import cpu_kind
from nw_eval.engine.plan import Plan, plan_jobs
from nw_eval.engine.prepare import build_splats, needs_splats, open_backend, ready_scans
from nw_eval.engine.run import RunOutcome, run_trials
from nw_eval.engine.workers.local import LocalProcesses
from nw_eval.errors import StoreError
from nw_eval.results.ended import write_trials
from nw_eval.results.journal import Journal, JournalHeader, has_begun
from nw_eval.results.machine import code_info, library_versions, machine_info
from nw_eval.results.planned import of_plan
from nw_eval.results.provenance import (
    PolicyInfo,
    RunInfo,
    SceneInfo,
    read_run_info,
    write_run_info,
)
from nw_eval.results.run_folder import RunFolder, create_run_folder, open_run_folder
from nw_eval.robots import get_robot
from nw_eval.rollout.confined.access import why_off
from nw_eval.suite import suite_yaml
from nw_eval.traceback_file import TracebackIn

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from nw_eval.engine.workers.protocol import Hire
    from nw_eval.results.row import Row
    from nw_eval.rollout.job import Backend
    from nw_eval.scenes.terrain.options import Collision

_REPORTS = "reports"


def run(
    plan: Plan,
    *,
    workers: int | None,
    out: Path | None,
    resume: Path | None,
    time_limit: float | None,
    render: Backend,
    command: tuple[str, ...],
    listener: Listener | None,
    in_process: bool = False,
    enough: Callable[[Sequence[Row]], bool] | None = None,
) -> RunFolder:
    """Run what has no result yet and leave a folder that can be judged, or resumed.

    run.json is written before there is a journal: whatever ends the run from then on, the folder
    says what it is of, and a folder without a journal's first line is one of which nothing has run.

    Args:
        plan: what is to be run.
        workers: how many; one for each core if None.
        out: the run's folder; a new one in `reports/` if None.
        resume: the folder of an interrupted run, whose finished trials are kept.
        time_limit: wall seconds after which a trial counts as hung.
        render: the splat backend.
        command: what was typed.
        listener: hears of progress.
        in_process: whether trials run in this very process, one after another, where nothing
            confines the policy or ends it: see `engine.workers.in_process`.
        enough: asked between rounds whether the rest need not run: see `run_trials`.

    Raises:
        IncomparableError: the run to resume was made under something else.
        StoreError: the folder cannot be made or written; what was written stays.
        SceneError: a splat cannot be made.
        PrerequisiteError: the renderer is not installed.
    """
    told = listener or Silence()
    workers = 1 if in_process else workers
    renders = needs_splats(plan.bundle.card, plan.suite.record)
    if renders:
        open_backend(render, told)
    folder = _folder(plan, out, resume)
    told.message(f"run folder: {folder.path}")
    # Workers and rows need a path that means the same everywhere.
    folder = RunFolder(path=folder.path.resolve())
    engine = _engine(render)
    info = _info(
        plan,
        folder,
        workers=workers,
        renderer=engine["renderer"],
        fence=_fence(plan, render, in_process=in_process),
        command=command,
    )
    header = _header(plan, engine)
    with TracebackIn(folder.path), _journal(folder, header, info) as journal:
        if journal.dropped:
            told.message(journal.dropped)
        of_plan(journal.rows, plan.trials, checkpoint=info.policy.checkpoint_digest)
        if resume is not None:
            earlier = read_run_info(folder.run_json)
            info = info.model_copy(update={"started": earlier.started, "wall_s": earlier.wall_s})
            write_run_info(folder.run_json, info)
        ready_scans(plan.scenes, told)
        _write_layout(folder, plan)
        if renders:
            build_splats(plan.scenes, told)
        text = suite_yaml(plan.suite)
        jobs = plan_jobs(plan, folder, render=render, time_limit=time_limit, suite_text=text)
        began = perf_counter()
        outcome = run_trials(
            jobs,
            journal=journal,
            folder=folder,
            policy=plan.bundle.name,
            hire=_in_process(plan) if in_process else LocalProcesses(jobs, folder),
            workers=workers,
            enough=enough,
            listener=told,
        )
        _finish(folder, plan, info, outcome, wall=perf_counter() - began)
    return folder


def _journal(folder: RunFolder, header: JournalHeader, info: RunInfo) -> Journal:
    """Go on with the folder's journal; if nothing has run, write run.json and start one."""
    if has_begun(folder.journal):
        return Journal.resume(folder.journal, header)
    write_run_info(folder.run_json, info)
    return Journal.create(folder.journal, header)


def _header(plan: Plan, engine: dict[str, str]) -> JournalHeader:
    return JournalHeader(
        suite_digest=plan.suite.digest,
        policy_digest=plan.bundle.digest,
        scene_digests={scene.name: scene.digest for scene in plan.scenes},
        engine=engine,
    )


def _folder(plan: Plan, out: Path | None, resume: Path | None) -> RunFolder:
    if resume is not None:
        return open_run_folder(resume)
    if out is None:
        return create_run_folder(
            Path(_REPORTS),
            suite=plan.suite.name,
            policy=plan.bundle.name,
            digest=plan.suite.content_digest,
        )
    folder = RunFolder(path=out)
    if has_begun(folder.journal):
        raise StoreError(
            f"{out} already holds a run", fix=f"go on with --resume {out}, or choose another --out"
        )
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(
            f"cannot make {out}: {error.strerror}", fix="choose another folder with --out"
        ) from error
    return folder


def _info(
    plan: Plan,
    folder: RunFolder,
    *,
    workers: int | None,
    renderer: str,
    fence: str,
    command: tuple[str, ...],
) -> RunInfo:
    """Return a run's provenance as it starts."""
    suite, bundle = plan.suite, plan.bundle
    return RunInfo(
        run=1,
        id=folder.id,
        started=_now(),
        suite_file=suite.source.file,
        suite_folder=str(suite.base.resolve()),
        suite=suite.model_dump(by_alias=True, mode="json"),
        suite_digest=suite.digest,
        policy=PolicyInfo(
            name=bundle.name,
            adapter=bundle.card.adapter,
            card_digest=bundle.digest,
            checkpoint_digest=bundle.checkpoint_digest,
            card="" if bundle.card_path is None else bundle.reference,
            origin="" if bundle.checkpoint is not None else bundle.origin,
            checkpoint="" if plan.checkpoint is None else str(plan.checkpoint.resolve()),
        ),
        scenes=_scene_infos(plan),
        collision=_collision(plan.references),
        workers=workers or default_workers(),
        renderer=renderer,
        fence=fence,
        command=command,
        code=code_info(),
        machine=machine_info(),
        versions=library_versions(),
    )


def _write_layout(folder: RunFolder, plan: Plan) -> None:
    """Write how Foxglove is to show the logs of this policy."""
    from nw_eval.rollout.observed.seen import (
        layout_of,  # It knows the simulator, and takes as long.
    )

    with atomic_path(folder.layout) as temporary:
        layout = layout_of(plan.bundle.card, get_robot(plan.suite.robot))
        temporary.write_text(layout, encoding="utf-8")


def _finish(
    folder: RunFolder, plan: Plan, info: RunInfo, outcome: RunOutcome, *, wall: float
) -> None:
    """Write the rows of the plan, and what run.json is to say of them."""
    rows, _ = of_plan(outcome.rows, plan.trials, checkpoint=info.policy.checkpoint_digest)
    ended = write_trials(folder, info, rows)
    write_run_info(
        folder.run_json,
        ended.model_copy(
            update={
                "finished": _now(),
                # A run that was resumed cost what all its sessions did.
                "wall_s": info.wall_s + wall,
                "interrupted": outcome.interrupted is not None,
                "stopped_after": outcome.stopped_after,
            }
        ),
    )


def _in_process(plan: Plan) -> Hire:
    from nw_eval.engine.workers.in_process import InProcess  # It knows the simulator.

    return InProcess(plan.bundle)


def _fence(plan: Plan, render: Backend, *, in_process: bool) -> str:
    """Return what stands round the workers of a run."""
    off = why_off(allow_code=plan.allow_code, render=render, in_process=in_process)
    network = "all" if plan.bundle.card.adapter == "remote" else "none"
    return str(Fence(off=off) if off else offered(network=network))


def _collision(references: Mapping[str, str]) -> Collision:
    return (
        "triangles"
        if any(text.startswith(TRIANGLES) for text in references.values())
        else "terrain"
    )


def _scene_infos(plan: Plan) -> dict[str, SceneInfo]:
    return {
        scene.name: SceneInfo(
            digest=scene.digest,
            task=scene.task,
            trials=sum(trial.scene == scene.name for trial in plan.trials),
        )
        for scene in plan.scenes
    }


def _engine(render: Backend) -> dict[str, str]:
    """Return what makes bits differ between runs of the same trials."""
    versions = library_versions()
    kept = ("mujoco", "numpy", "onnxruntime", "torch", "numba", "embreex")
    return {
        **{name: versions[name] for name in kept if name in versions},
        "renderer": f"{render} gsplat-1.5",
        "cpu": cpu_kind(),
        "code": code_info().digest[:16],
    }


def _now() -> str:
    return datetime.now(tz=UTC).isoformat(timespec="seconds")
