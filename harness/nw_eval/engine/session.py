"""One run from its folder to its rows: provenance first, then trials, then the Parquet file."""

from __future__ import annotations

from collections import Counter
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, nullcontext
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, Protocol, Self

from nw_base.errors import UsageError
from nw_base.files.cache import atomic_path, made_place
from nw_base.files.traceback_file import TracebackIn
from nw_eval.engine.cache import told_of_cache
from nw_eval.engine.known import known_trials
from nw_eval.engine.machine import Interrupts, worker_count
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
from nw_eval.engine.rounds import Attempts
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
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from nw_eval.engine.how import How
    from nw_eval.engine.known import KnownTrials, NothingKnown
    from nw_eval.engine.listener import Listener
    from nw_eval.engine.pool import StartWorkers, Workers
    from nw_eval.engine.rounds import Enough, RunStanding
    from nw_gate.results.provenance import RunInfo
    from nw_gate.results.row import Row
    from nw_scenes import Scene

_REPORTS = "reports"


class BaselineComparison(Protocol):
    """The comparison with a baseline, as `carry_out` uses it; a context manager."""

    def __enter__(self) -> object: ...

    def __exit__(self, *error: object) -> None: ...

    def begin(self, own: Session, interrupts: Interrupts) -> RunInfo:
        """Return what run.json is to say once it is known what the baseline is to this machine.

        A `stop` with no trial, or `interrupted`, ends the run there.
        """
        ...

    def next(self, ended: Mapping[int, Row]) -> RunStanding:
        """Return how it stands, from the rows that have ended by index in the drawn order."""
        ...

    def run_control(self, indexes: Sequence[int]) -> None:
        """Run trials of the baseline's own policy at indexes of the drawn order."""
        ...

    def end(self, run: RunInfo) -> None:
        """Receive run.json after the last trial."""
        ...


def carry_out(
    plan: Plan,
    how: How,
    *,
    out: Path | None = None,
    resume: Path | None = None,
    comparison: BaselineComparison | None = None,
    meanwhile: Callable[[], None] | None = None,
) -> RunFolder:
    """Run what has no result yet and leave a folder that can be judged, or resumed.

    Against a baseline, `comparison` says after each trial what comes next. Where it needs trials of
    the baseline's own policy, these run between those of the plan.

    Args:
        plan: what is to be run.
        how: how it is run.
        out: the run's folder (default: a new one in `reports/`).
        resume: the folder of an interrupted run, whose finished trials are kept.
        comparison: the plan against its baseline; None = all trials run.
        meanwhile: called in a thread while trials run in other processes; it raises nothing.

    Raises:
        IncomparableError: the run to resume was made under something else.
        StoreError: the folder cannot be made or written; what was written stays.
        SceneError: a splat cannot be made.
        PrerequisiteError: the renderer is not installed, or Ray.
        UsageError: `out` holds a run; there is no such cluster, or it cannot be sent what the run
            needs; or `NW_EVAL_CACHE_GB` is no size.
    """
    interrupts = Interrupts()
    with (
        Session(plan, how, interrupts, out=out, resume=resume, meanwhile=meanwhile) as own,
        comparison or nullcontext(),
    ):
        if comparison is not None:
            own.keep(comparison.begin(own, interrupts))
        if (own.info.stop is None or own.info.stop.trials) and not own.info.interrupted:
            # What is enough shows in the order of the whole run only, of which a part has none.
            enough = None if comparison is None or plan.shard else comparison.next
            with interrupts:
                while (standing := own.run(enough)) is not None and standing.lacks:
                    assert comparison is not None, "only a comparison can lack trials of a control"
                    comparison.run_control(standing.lacks)
            own.finish(None if standing is None else stop_of(plan, standing))
        else:
            own.finish(own.info.stop)
        if comparison is not None:
            comparison.end(own.info)
    return own.folder


class Session:
    """A run under way: its folder, its journal and its workers; a context manager.

    run.json is written before there is a journal: whatever ends the run from then on, the folder
    says what it is of, and a folder without a journal's first line is one of which nothing has run.

    Args:
        plan: what is to be run.
        how: how it is run.
        interrupts: receives signals while trials run.
        out: the run's folder (default: a new one in `reports/`).
        resume: the folder of an interrupted run, whose finished trials are kept.
        meanwhile: called in a thread while trials run in other processes; it raises nothing.

    Raises, when entered:
        As `carry_out`.
    """

    folder: RunFolder
    info: RunInfo
    """What run.json says, or is to say once something has run."""

    def __init__(
        self,
        plan: Plan,
        how: How,
        interrupts: Interrupts,
        *,
        out: Path | None = None,
        resume: Path | None = None,
        meanwhile: Callable[[], None] | None = None,
    ) -> None:
        self._plan, self._how, self._interrupts = plan, how, interrupts
        self._out, self._resume, self._meanwhile = out, resume, meanwhile
        self._cleanup, self._running = ExitStack(), ExitStack()
        self._attempts: Attempts | None = None
        self._known: KnownTrials | NothingKnown | None = None

    def __enter__(self) -> Self:
        plan, how, told = self._plan, self._how, self._how.told
        words = told_of_cache()  # Before anything is written, as a size may be invalid.
        if words and not how.uncached:
            told.message(words)
        with ExitStack() as stack:
            self._place = stack.enter_context(worker_pool(how))
            self._builders = stack.enter_context(
                SplatBuilders(
                    _scenes_by_first_use(plan) if plan.renders else (),
                    count=worker_count(self._place.workers, len(plan.scenes)),
                    on_demand=not needs_splats_first(plan.bundle.card, plan.suite.record),
                    listener=told,
                )
            )
            _open_backend(plan, told, self._builders, in_process=how.in_process)
            folder = _folder(plan, self._out, self._resume)
            told.message(f"run folder: {folder.path}")
            # Workers and rows need a path that means the same everywhere.
            self.folder = RunFolder(path=folder.path.resolve())
            self.info = run_info(plan, self.folder, how, workers=self._place.workers)
            stack.enter_context(TracebackIn(self.folder.path))
            self._journal = stack.enter_context(_journal(plan, self.folder, self.info))
            if self._journal.dropped:
                told.message(self._journal.dropped)
            of_plan(self._journal.rows, plan.trials, checkpoint=self.info.policy.checkpoint_digest)
            if self._resume is not None:
                self.info = _with_earlier_sessions(self.info, self.folder)
                drop_links(self.folder.path)
            self._began = perf_counter()
            self._earlier_s = self.info.wall_s
            stack.push(self._running)
            self._cleanup = stack.pop_all()
        return self

    def __exit__(self, *error: Any) -> None:  # noqa: PYI036 - an exit stack wants their types.
        self._cleanup.__exit__(*error)

    def keep(self, info: RunInfo) -> None:
        """Let run.json say something else."""
        self.info = info
        write_run_info(self.folder.run_json, info)

    def run(self, enough: Enough | None = None) -> RunStanding | None:
        """Run trials until they are enough: see `Attempts.run`."""
        attempts = self._begun()
        standing = attempts.run(enough)
        if standing is not None and standing.lacks and not self._place.is_local:
            attempts.stop_workers()  # A cluster has no cores for those of two runs.
        return standing

    def run_these(self, places: Iterable[int]) -> None:
        """Run the trials at some places of the drawn order that have no result; end the workers."""
        attempts = self._begun()
        drop_links(self.folder.path)
        with self._interrupts:
            attempts.settle([attempts.by_place[place] for place in sorted(places)])
        attempts.stop_workers()

    def finish(self, stop: StopInfo | None) -> None:
        """End all workers, and write the rows that are judged.

        Args:
            stop: which trials were enough; None = all.
        """
        if self._attempts is not None:
            self._running.close()
        self.write_rows(stop)

    def write_rows(self, stop: StopInfo | None) -> None:
        """Write the rows that are judged, and run.json; more trials may run afterwards.

        Args:
            stop: which trials were enough; None = all.
        """
        plan, folder, info = self._plan, self.folder, self.info
        if self._known is not None:
            info = _with_cache(self._before, self._known.info)
        is_cut = info.interrupted or self._interrupts.requested is not None
        info = info.model_copy(update={"interrupted": is_cut, "stop": stop})
        rows, _ = of_plan(
            self._journal.rows,
            wanted(plan.trials, info.stop),
            checkpoint=info.policy.checkpoint_digest,
        )
        ended = write_trials(folder, info, rows)
        link_logs(folder.path, rows)
        # A run that was resumed cost what all its sessions did.
        wall = self._earlier_s + perf_counter() - self._began
        self.keep(ended.model_copy(update={"finished": now(), "wall_s": wall}))

    def _begun(self) -> Attempts:
        """Return the runner of attempts, with workers, scenes and the cache opened once."""
        if self._attempts is not None:
            return self._attempts
        plan, how, folder, stack = self._plan, self._how, self.folder, self._running
        _ready_scenes(plan, self._builders, how.told, is_local=self._place.is_local)
        jobs = plan_jobs(plan, folder)
        self._before = self.info
        start_workers = stack.enter_context(
            self._place.start_workers(plan, jobs, folder, how.told, self._builders)
        )
        self._known = stack.enter_context(
            known_trials(
                plan, folder, off=how.uncached, listener=how.told, doubted=self._write_cache
            )
        )
        begins = stack.enter_context(BackgroundTask(start_workers, self._beside_trials))
        self._attempts = stack.enter_context(
            Attempts(
                jobs=jobs,
                journal=self._journal,
                folder=folder,
                policy=plan.bundle.name,
                arm=plan.arm,
                start_workers=begins,
                wanted_workers=self._place.workers,
                listener=how.told,
                known=self._known,
                interrupts=self._interrupts,
            )
        )
        how.told.planned(total=len(jobs), finished=self._attempts.finished)
        return self._attempts

    def _write_cache(self) -> None:
        assert self._known is not None, "it is what calls this"
        write_run_info(self.folder.run_json, _with_cache(self._before, self._known.info))

    def _beside_trials(self) -> None:
        _write_layout(self._plan, self.folder)
        if self._meanwhile is not None and not self._how.in_process:
            self._meanwhile()


def _scenes_by_first_use(plan: Plan) -> list[Scene]:
    """Return the scenes of a plan in the order in which its trials need them."""
    names = dict.fromkeys(trial.scene for trial in in_order(plan.trials))
    scenes = {scene.name: scene for scene in plan.scenes}
    return [scenes[name] for name in names if name in scenes]


def _open_backend(
    plan: Plan, listener: Listener, builders: SplatBuilders, *, in_process: bool
) -> None:
    """Compile the kernels of renderer, rays and networks while splats are built beside it."""
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
        _keep_baseline(plan, folder)
        return journal
    _keep_baseline(plan, folder)
    write_run_info(folder.run_json, info)
    return Journal.create(folder.journal, header)


def _keep_baseline(plan: Plan, folder: RunFolder) -> None:
    """Copy the baseline that the run is compared with into its folder, if it is not there."""
    if plan.against is None:
        return
    path = folder.baseline_file(plan.against.info.name)
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
