"""One run from its folder to its rows: provenance first, then trials, then the Parquet file."""

from __future__ import annotations

from collections import Counter
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Self

from nw_base.errors import UsageError
from nw_base.files.cache import atomic_path, made_place
from nw_base.files.traceback_file import TracebackIn
from nw_eval.engine.cache import told_of_cache
from nw_eval.engine.known import known_trials
from nw_eval.engine.listener import Listener, NullListener
from nw_eval.engine.machine import worker_count
from nw_eval.engine.order import in_order
from nw_eval.engine.plan import Plan, plan_jobs
from nw_eval.engine.prepare import (
    SplatBuilders,
    build_splats,
    needs_splats_first,
    open_backend,
    ready_scans,
)
from nw_eval.engine.provenance import journal_header, now, run_info
from nw_eval.engine.rounds import run_trials
from nw_eval.engine.workers import worker_pool
from nw_gate.results.ended import of_plan, wanted, write_trials
from nw_gate.results.journal import Journal, has_begun
from nw_gate.results.log_links import drop_links, link_logs
from nw_gate.results.provenance import CacheInfo, StopInfo, read_run_info, write_run_info
from nw_gate.results.run_folder import (
    RunFolder,
    check_folders,
    create_run_folder,
    open_run_folder,
)
from nw_policies.bundle import senses_by_code
from nw_scenes.robots import get_robot
from nw_sim.rollout.confined.access import why_off

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from nw_eval.engine.pool import StartWorkers, Workers
    from nw_eval.engine.rounds import Enough, RunStanding
    from nw_gate.results.provenance import RunInfo
    from nw_gate.results.row import Row
    from nw_scenes import Scene

    Prelude = Callable[[RunFolder, RunInfo], RunInfo]

_REPORTS = "reports"


def carry_out(
    plan: Plan,
    *,
    workers: int | None,
    out: Path | None,
    resume: Path | None,
    command: tuple[str, ...],
    labels: Mapping[str, str] | None = None,
    listener: Listener | None,
    in_process: bool = False,
    cluster: str | None = None,
    prelude: Prelude | None = None,
    enough: Enough | None = None,
    cache: bool = True,
    meanwhile: Callable[[], None] | None = None,
) -> RunFolder:
    """Run what has no result yet and leave a folder that can be judged, or resumed.

    run.json is written before there is a journal: whatever ends the run from then on, the folder
    says what it is of, and a folder without a journal's first line is one of which nothing has run.

    Args:
        plan: what is to be run.
        workers: how many; one for each core if None.
        out: the run's folder; a new one in `reports/` if None.
        resume: the folder of an interrupted run, whose finished trials are kept.
        command: what was typed.
        labels: what its user calls it; a run that is resumed keeps those that it has besides.
        listener: hears of progress.
        in_process: whether trials run in this very process: see `engine.workers`.
        cluster: the address of the Ray cluster on whose nodes trials run: see
            `engine.ray_connection`; None = in processes of this machine.
        prelude: called before the first trial, with the run's folder and run.json, of which it
            returns what it is to say from then on; a `stop` with no trial, or `interrupted`, ends
            the run there.
        enough: asked after each trial what comes next: see `run_trials`.
        cache: whether results of earlier runs are reused: see `engine.known`.
        meanwhile: called in a thread while trials run in other processes; it raises nothing.

    Raises:
        IncomparableError: the run to resume was made under something else.
        StoreError: the folder cannot be made or written; what was written stays.
        SceneError: a splat cannot be made.
        PrerequisiteError: the renderer is not installed, or Ray.
        UsageError: `out` holds a run; there is no such cluster, or it cannot be sent what the run
            needs; or `NW_EVAL_CACHE_GB` is no size.
    """

    def beside_trials() -> None:
        _write_layout(plan, folder)
        if meanwhile is not None and not in_process:
            meanwhile()

    listener = listener or NullListener()
    told = told_of_cache()  # Before anything is written, if a size is none.
    if told and not _uncached(cache=cache, in_process=in_process):
        listener.message(told)
    with (
        worker_pool(workers=workers, in_process=in_process, cluster=cluster) as place,
        SplatBuilders(
            _in_need(plan) if plan.renders else (),
            count=worker_count(place.workers, len(plan.scenes)),
            on_demand=not needs_splats_first(plan.bundle.card, plan.suite.record),
            listener=listener,
        ) as builders,
    ):
        _open_backend(plan, listener, builders, in_process=in_process)
        folder = _folder(plan, out, resume)
        listener.message(f"run folder: {folder.path}")
        # Workers and rows need a path that means the same everywhere.
        folder = RunFolder(path=folder.path.resolve())
        info = run_info(
            plan,
            folder,
            workers=place.workers,
            in_process=in_process,
            command=command,
            labels=labels,
        )
        with TracebackIn(folder.path), _journal(plan, folder, info) as journal:
            if journal.dropped:
                listener.message(journal.dropped)
            of_plan(journal.rows, plan.trials, checkpoint=info.policy.checkpoint_digest)
            if resume is not None:
                info = _with_earlier_sessions(info, folder)
                drop_links(folder.path)
            began = perf_counter()
            if prelude is not None:
                info = prelude(folder, info)
                write_run_info(folder.run_json, info)
            if (info.stop is None or info.stop.trials) and not info.interrupted:
                _ready_scenes(plan, builders, listener, is_local=place.is_local)
                jobs = plan_jobs(plan, folder)
                with (
                    place.start_workers(plan, jobs, folder, listener, builders) as start_workers,
                    known_trials(
                        plan,
                        folder,
                        off=_uncached(cache=cache, in_process=in_process),
                        listener=listener,
                        doubted=lambda: write_run_info(
                            folder.run_json, _with_cache(info, known.info)
                        ),
                    ) as known,
                    BackgroundTask(start_workers, beside_trials) as begins,
                ):
                    outcome = run_trials(
                        jobs,
                        journal=journal,
                        folder=folder,
                        policy=plan.bundle.name,
                        arm=plan.arm,
                        start_workers=begins,
                        workers=place.workers,
                        enough=enough,
                        listener=listener,
                        known=known,
                    )
                enough_ran = None if outcome.enough is None else stop_of(plan, outcome.enough)
                info = _with_cache(info, known.info).model_copy(
                    update={"interrupted": outcome.interrupted is not None, "stop": enough_ran}
                )
            _finish(plan, folder, info, journal.rows, wall=perf_counter() - began)
        return folder


def _in_need(plan: Plan) -> list[Scene]:
    """Return the scenes of a plan in the order in which its trials need them."""
    names = dict.fromkeys(trial.scene for trial in in_order(plan.trials))
    scenes = {scene.name: scene for scene in plan.scenes}
    return [scenes[name] for name in names if name in scenes]


def _open_backend(
    plan: Plan, listener: Listener, builders: SplatBuilders, *, in_process: bool
) -> None:
    """Compile what draws, casts rays and runs networks, while splats are built beside it."""
    code = plan.request.allow_code and senses_by_code(plan.bundle.card)
    open_backend(
        plan.render if plan.renders else "cpu",
        listener,
        is_fenced=not why_off(code=code, render=plan.render, in_process=in_process),
        surfaces=plan.bundle.card.meets_splat,
        kernels=plan.kernels,
        beside=builders.beside_compiler(),
    )


def _ready_scenes(
    plan: Plan, builders: SplatBuilders, listener: Listener, *, is_local: bool
) -> None:
    """Make ready what trials need: on this machine, not the splats that are built beside them."""
    ready_scans(plan.scenes, listener)
    if not is_local:
        builders.wait()
    if plan.renders:
        missing = set(builders.missing) if is_local else ()
        build_splats((s for s in plan.scenes if s.name not in missing), listener)


def _folder(plan: Plan, out: Path | None, resume: Path | None) -> RunFolder:
    """Return the folder of the run, which exists from now on."""
    if resume is not None:
        return open_run_folder(resume)
    if out is None:
        return create_run_folder(
            Path(_REPORTS),
            suite=plan.suite.name,
            policy=plan.bundle.name,
            digest=plan.suite.content_digest,
            part=plan.request.shard or "",
        )
    made_place(out)
    check_folders(out)
    folder = RunFolder(path=out)
    if has_begun(folder.journal):
        raise UsageError(
            f"{out} already holds a run",
            fix=f"continue with --resume {out}, or choose another --out",
        )
    return folder


def _journal(plan: Plan, folder: RunFolder, info: RunInfo) -> Journal:
    """Go on with the folder's journal; if nothing has run, write run.json and start one."""
    header = journal_header(plan)
    if has_begun(folder.journal):
        journal = Journal.resume(folder.journal, header)
        _keep_bank(plan, folder)
        return journal
    _keep_bank(plan, folder)
    write_run_info(folder.run_json, info)
    return Journal.create(folder.journal, header)


def _keep_bank(plan: Plan, folder: RunFolder) -> None:
    """Copy the baseline that the run is compared with into its folder, if it is not there."""
    if plan.against is None:
        return
    path = folder.bank(plan.against.info.name)
    if not path.exists():
        with atomic_path(path) as temporary:
            temporary.write_bytes(plan.against.content)


def _with_earlier_sessions(info: RunInfo, folder: RunFolder) -> RunInfo:
    """Write run.json anew with when the run was begun, and what it has cost until now."""
    earlier = read_run_info(folder.run_json)
    if earlier.baseline and info.baseline and earlier.baseline.sha256 == info.baseline.sha256:
        # What the baseline showed on this machine holds until it has been looked at again.
        info = info.model_copy(update={"baseline": earlier.baseline})
    since = {"started": earlier.started, "wall_s": earlier.wall_s, "cache": earlier.cache}
    info = info.model_copy(update={**since, "labels": {**earlier.labels, **info.labels}})
    write_run_info(folder.run_json, info)
    return info


def _write_layout(plan: Plan, folder: RunFolder) -> None:
    """Write how Foxglove is to show the logs of this policy."""
    # They know the simulator, which this process may have no other use for.
    from nw_eval.viewing.shown import layout_json, shown_by_card

    with atomic_path(folder.layout) as temporary:
        shown = shown_by_card(plan.bundle.card, get_robot(plan.suite.robot))
        temporary.write_text(layout_json(shown), encoding="utf-8")


def _with_cache(info: RunInfo, since: CacheInfo) -> RunInfo:
    """Return run.json with what this session's trials of earlier runs were."""
    return info.model_copy(update={"cache": since.after(info.cache)})


def stop_of(plan: Plan, standing: RunStanding) -> StopInfo:
    """Return what run.json says of the trials that were enough."""
    stop = StopInfo(first=standing.first, followed=standing.followed)
    counts = Counter(trial.scene for trial in wanted(plan.trials, stop))
    return stop.model_copy(update={"trials": dict(sorted(counts.items()))})


def _uncached(*, cache: bool, in_process: bool) -> str:
    """Return why a run is to do without the cache of trials; empty if it is not."""
    if in_process:
        return "in the calling process"  # For a debugger, which wants to see it run.
    return "" if cache else "--no-cache"


def _finish(
    plan: Plan, folder: RunFolder, info: RunInfo, rows: Iterable[Row], *, wall: float
) -> None:
    """Write the rows of the plan, and what run.json is to say of them."""
    trials = wanted(plan.trials, info.stop)
    rows, _ = of_plan(rows, trials, checkpoint=info.policy.checkpoint_digest)
    ended = write_trials(folder, info, rows)
    link_logs(folder.path, rows)
    write_run_info(
        folder.run_json,
        ended.model_copy(
            update={
                "finished": now(),
                # A run that was resumed cost what all its sessions did.
                "wall_s": info.wall_s + wall,
            }
        ),
    )


class BackgroundTask:
    """Gets workers, and does something else once it has; a context manager.

    Before it has, whatever else this process does keeps the first trial waiting.

    Args:
        start_workers: gets the workers.
        work: done once, in a thread of its own; at the block's end if there was nothing to run. The
            block's end waits for it, and raises what it raises.
    """

    def __init__(self, start_workers: StartWorkers, work: Callable[[], None]) -> None:
        self._start_workers = start_workers
        self._work = work
        self._thread = ThreadPoolExecutor(max_workers=1)
        self._done: Future[None] | None = None

    @property
    def again(self) -> str:
        """Where a job that is run again runs."""
        return self._start_workers.again

    def __call__(self, count: int, *, fresh: bool) -> Workers:
        """Return workers."""
        workers = self._start_workers(count, fresh=fresh)
        self._begin()
        return workers

    def __enter__(self) -> Self:
        return self

    def __exit__(self, failure: object, *_: object) -> None:
        with self._thread:
            if failure is None:
                self._begin().result()

    def _begin(self) -> Future[None]:
        if self._done is None:
            self._done = self._thread.submit(self._work)
        return self._done
