"""A training's folder: each checkpoint is evaluated as it appears, and gated against the best one.

Every checkpoint meets the same starts, so that a curve of success over training steps shows the
policy and not the draw.
"""

from __future__ import annotations

import hashlib
import json
import re
import stat
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from nw_base.errors import IncomparableError, PolicyError, StoreError, UsageError
from nw_base.files.cache import made_place
from nw_base.files.inside import regular
from nw_eval.api.paths import as_path
from nw_eval.api.renamed import keywords_were
from nw_eval.engine.how import How

if TYPE_CHECKING:
    from os import PathLike

    from nw_eval.api.reports import RunReport
    from nw_eval.api.surfaces import Surfaces
    from nw_gate.limits.ladder import Ladder
    from nw_gate.results.request import Request

SUFFIXES = (".jit", ".msgpack", ".onnx", ".pt", ".pt2", ".pth", ".safetensors", ".zip")
"""How the names of checkpoints end."""

_REPORTS = Path("reports")
_STATE, _TABLE, _PAGE = "watch.json", "watch.parquet", "index.html"
_MOST_STATE = 64 * 2**20
_AS_WRITTEN: dict[str, Any] = {"strict": True, "extra": "forbid", "allow_inf_nan": False}
_MOST_DIGITS = 15
"""Of a training step; a longer number is a date, a digest or the like."""
_FIRST_LOOK = 1.0
"""Seconds between the first two looks at a folder."""


@dataclass(frozen=True, kw_only=True)
class WatchedCheckpoint:
    """What became of one checkpoint of a training."""

    __pydantic_config__: ClassVar[dict[str, Any]] = _AS_WRITTEN

    name: str
    """Its path in the training's folder."""
    step: int
    """Of the training: the last number in its name, or else in its folder's."""
    sha256: str
    run: str
    """The folder of its run in the folder of the watch; empty where it could not be used."""
    verdict: str = ""
    success: float | None = None
    low: float | None = None
    """Lower bound of success, at the suite's confidence."""
    high: float | None = None
    trials: int = 0
    completed: int = 0
    against: int | None = None
    """The step of the best checkpoint so far, which it was gated against."""
    drop: float | None = None
    """Of success, from that one to this."""
    drop_low: float | None = None
    drop_high: float | None = None
    drop_trials: int = 0
    """How many trials settled the comparison, of all that ran: `drop` is of those alone."""
    problem: str = ""
    """Why it could not be used."""
    scores: dict[str, float] = field(default_factory=dict[str, float])
    """Means of what was measured beside success, by name, each in its unit."""
    limits: dict[str, tuple[float | None, float | None]] = field(
        default_factory=dict[str, tuple[float | None, float | None]]
    )
    """Hardest value that is cleared and easiest that is not, by ladder, each in its unit."""


@dataclass(frozen=True, kw_only=True)
class _State:
    """What a folder of a watch says of it, in the order of evaluation."""

    __pydantic_config__: ClassVar[dict[str, Any]] = _AS_WRITTEN

    suite: str
    """The suite's name and content digest."""
    card: str
    """The digest of the policy's card."""
    trials: int | None
    scenes: tuple[str, ...] | None
    checkpoints: tuple[WatchedCheckpoint, ...] = ()


@dataclass(frozen=True, kw_only=True)
class WatchedTraining:
    """A training, as far as its checkpoints were evaluated."""

    folder: Path
    """Of the runs, the table and the page."""
    checkpoints: tuple[WatchedCheckpoint, ...]
    """In order of their steps."""
    best: WatchedCheckpoint | None
    interrupted: bool
    page: Path
    """To open: success over training steps."""
    table: Path
    """The same as Parquet, a row for each checkpoint."""

    @property
    def exit_code(self) -> int:
        """That of the newest checkpoint's verdict, 2 if it has none; 130 if interrupted."""
        from nw_gate.verdict import EXIT_CODES

        if self.interrupted:
            return 130
        codes: dict[str, int] = {str(word): code for word, code in EXIT_CODES.items()}
        verdict = self.checkpoints[-1].verdict if self.checkpoints else ""
        return codes.get(verdict, UsageError.exit_code)


@keywords_were(card="policy")
def watch(
    folder: str | Path,
    *,
    suite: str | Path,
    policy: str | None = None,
    pattern: str = "*",
    every: int = 1,
    once: bool = False,
    idle: float | None = None,
    interval: float = 5.0,
    out: str | PathLike[str] | None = None,
    where: Surfaces | None = None,
    progress: Callable[[WatchedCheckpoint], None] | None = None,
    **changes: Any,
) -> WatchedTraining:
    """Evaluate the checkpoints of a training as they appear, the latest first.

    Each meets all trials of the suite, and is judged by the suite's bar and against the best
    checkpoint before it: the one with the largest mean success, where that is above the gate's
    `max_drop`. Checkpoints have one of `SUFFIXES`. One whose bytes change under its name is another
    one. Page and table are written after each.

    Args:
        folder: the folder that a training writes to. Checkpoints are files below it with a number
            in their name or their folder's name: `model_1500.pt`.
        suite: a suite file or the name of a shipped one.
        policy: card that describes these checkpoints: a policy's name or folder, or a card
            (default: the suite's policy).
        pattern: only files whose names match this glob.
        every: evaluate every n-th step, from the first.
        once: exit when all existing checkpoints are evaluated.
        idle: exit after this many seconds without a new checkpoint (default: run until Ctrl-C or
            SIGTERM).
        interval: seconds between two scans of the folder. A file is evaluated when two scans find
            it unchanged.
        out: the folder of runs, table and page; an earlier watch there is resumed (default:
            `reports/watch-<suite>-<folder>`).
        where: trackers that show each run at its training step.
        progress: receives each checkpoint that was evaluated.
        changes: of `Request`: trials, scenes, record, render, time_limit, memory_limit, allow_code;
            of `How`: workers, cache, listener.

    Raises:
        UsageError, SuiteError, PolicyError: the folder, the suite or the card cannot be used. A
            checkpoint that cannot be is named, and the next one is taken.
        IncomparableError: `out` is of another suite or card.
        StoreError: results cannot be written.
    """
    from nw_eval.api.surfaces import Surfaces
    from nw_gate.results.request import Request

    out = as_path(out)
    folder = Path(folder)
    if not folder.is_dir():
        raise UsageError(
            f"{folder} is not a folder", fix="name the folder that a training writes to"
        )
    if every < 1 or not interval > 0.0 or (idle is not None and not idle >= 0.0):
        raise UsageError(
            f"every {every}, interval {interval:g}, idle {idle}: one is too low",
            fix="give an `every` of 1 or more, and seconds above 0",
        )
    how = How.taken_from(changes, "workers", "cache", "listener")
    request = Request.of(suite, policy=policy, **changes)
    watched = _Watch(folder, request, out, where or Surfaces(), how)
    for reason in watched.obstacles:
        how.told.message(f"a checkpoint after the first cannot PASS: {reason}")
    seen: dict[Path, tuple[int, int]] = {}
    last, interrupted = time.monotonic(), False
    while not interrupted:
        found, seen, changing = _ready(folder, pattern, seen, apart=watched.folder)
        todo = [each for each in watched.chosen(found, every) if not watched.has(each)]
        if todo:
            made = watched.evaluate(todo[-1])
            interrupted = made is None
            if made is not None and progress is not None:
                progress(made)
            last = time.monotonic()
            continue
        if not changing and (once or (idle is not None and time.monotonic() - last >= idle)):
            break
        time.sleep(min(interval, _FIRST_LOOK) if changing else interval)
    return watched.result(interrupted=interrupted)


@dataclass(frozen=True)
class _Found:
    """A file that looks like a checkpoint."""

    step: int
    name: str
    path: Path
    mark: tuple[int, int]  # bytes and time of its last change


def training_step(path: Path) -> int | None:
    """Return the training step in a checkpoint's name, or else in its folder's; None without one.

    It is the last number: 1500 of `model_1500.pt`, 20 of `run3/000020/params.msgpack`.
    """
    for name in (path.stem, path.parent.name):
        if numbers := re.findall(r"[0-9]+", name):
            return int(numbers[-1]) if len(numbers[-1]) <= _MOST_DIGITS else None
    return None


def _printable(path: Path) -> str:
    """Return a path as text that any file can hold: names need not be UTF-8."""
    return str(path).encode("utf-8", "backslashreplace").decode("utf-8")


def checkpoints_in(folder: Path, pattern: str = "*") -> list[Path]:
    """Return the checkpoints of a training in order of their steps.

    Args:
        folder: of the training.
        pattern: a glob that their names match.
    """
    found = [
        (step, str(path.relative_to(folder)), path)
        for path in folder.rglob(pattern)
        if path.suffix in SUFFIXES and (step := training_step(path)) is not None
    ]
    return [path for _, _, path in sorted(found)]


def _ready(
    folder: Path, pattern: str, seen: dict[Path, tuple[int, int]], *, apart: Path
) -> tuple[list[_Found], dict[Path, tuple[int, int]], bool]:
    """Return files that are as they were at the last look, all files, and whether some changed."""
    now: dict[Path, tuple[int, int]] = {}
    found: list[_Found] = []
    own = apart.resolve()
    for path in checkpoints_in(folder, pattern):
        try:
            facts = path.stat()
        except OSError:  # It was removed meanwhile.
            continue
        real = path.resolve()
        # A link may lead to another checkpoint of the training, and nowhere else.
        if not real.is_relative_to(folder.resolve()) or real.is_relative_to(own):
            continue
        if not stat.S_ISREG(facts.st_mode):
            continue
        now[path] = facts.st_size, facts.st_mtime_ns
        if seen.get(path) == now[path]:
            step = training_step(path)
            assert step is not None, "it is among those that have one"
            found.append(_Found(step, _printable(path.relative_to(folder)), path, now[path]))
    return found, now, any(seen.get(path) != mark for path, mark in now.items())


STARTS, STARTS_OF_FEW, _FEW_SCENES = 30, 60, 2
"""Starts a scene of the baseline of a best checkpoint; and in a suite of one or two scenes. In
50 equal checkpoints each is then REGRESSED with less than 0.5 % (tests/gate/stats)."""
_OF_BASELINES = ("scenes", "robot", "render", "time_limit", "memory_limit", "allow_code")
"""What a baseline's trials have of a request."""


@dataclass
class _Watch:
    """One watch: what it has evaluated, and how it evaluates more."""

    training: Path
    request: Request
    out: Path | None
    where: Surfaces
    how: How
    folder: Path = field(init=False)
    obstacles: tuple[str, ...] = field(init=False)
    """Why no checkpoint can PASS beside one that never fails."""
    _state: _State = field(init=False)
    _ladders: dict[str, Ladder] = field(init=False)
    _known: set[tuple[str, tuple[int, int]]] = field(
        init=False, default_factory=set[tuple[str, tuple[int, int]]]
    )

    def __post_init__(self) -> None:
        from nw_eval.api.surfaces import check_surfaces
        from nw_eval.suite import load_suite
        from nw_eval.suite.ladders import gated_ladder
        from nw_policies import find_card
        from nw_sim.ladders import ladder_named

        check_surfaces(self.where)
        assert self.request.suite is not None, "a watch is of a suite"
        suite = load_suite(self.request.suite)
        self.obstacles = _obstacles(self.request)
        policy = self.request.policy or suite.policy
        name = re.sub(r"[^A-Za-z0-9_.]+", "-", self.training.resolve().name)
        self.folder = self.out or _REPORTS / f"watch-{suite.name}-{name}"
        self._state = _State(
            suite=f"{suite.name} {suite.content_digest}",
            card=_sha256(find_card(policy)),
            trials=self.request.trials,
            scenes=self.request.scenes,
        )
        self._ladders = {
            name: gated_ladder(ladder_named(name, suite.base)) for name in suite.gate.limits
        }
        self._confidence, self._most_drop = suite.gate.confidence, suite.gate.most_drop
        earlier = _read_state(self.folder / _STATE)
        if earlier is not None:
            if replace(earlier, checkpoints=()) != self._state:
                raise IncomparableError(
                    f"{self.folder} is of another suite, card, scenes or number of trials",
                    fix="choose another --out",
                )
            self._state = earlier
        made_place(self.folder)
        made_place(self.folder / "checkpoints")

    def chosen(self, found: Sequence[_Found], every: int) -> list[_Found]:
        """Return each n-th step's files, in order of their steps."""
        steps = sorted({each.step for each in found})[::every]
        return [each for each in found if each.step in set(steps)]

    def has(self, found: _Found) -> bool:
        """Whether a file was evaluated as it is now."""
        if (found.name, found.mark) in self._known:
            return True
        try:
            digest = _sha256(found.path)
        except OSError:
            return True  # It was removed meanwhile.
        is_known = any(
            (each.name, each.sha256) == (found.name, digest) for each in self._state.checkpoints
        )
        if is_known:
            self._known.add((found.name, found.mark))
        return is_known

    def evaluate(self, found: _Found) -> WatchedCheckpoint | None:
        """Evaluate a checkpoint, and write page and table; None if a signal came first."""
        copy, digest = self._copied(found)
        key = copy.stem
        made = WatchedCheckpoint(name=found.name, step=found.step, sha256=digest, run="")
        try:
            judged = self._judged(copy, self.folder / "runs" / key, found.step)
        except PolicyError as error:
            made = replace(made, problem=str(error))
            copy.unlink(missing_ok=True)
        else:
            if judged is None:
                return None
            if judged.interrupted and judged.verdict.verdict == "INFRASTRUCTURE":
                return None
            made = self._with_verdict(made, judged, key)
            self._publish(judged, found.step)
        self._known.add((found.name, found.mark))
        self._state = replace(self._state, checkpoints=(*self._state.checkpoints, made))
        self._write()
        return made

    def result(self, *, interrupted: bool) -> WatchedTraining:
        """Return what is known of the training."""
        self._write()
        return WatchedTraining(
            folder=self.folder,
            checkpoints=tuple(self._ordered()),
            best=self._best(),
            interrupted=interrupted,
            page=self.folder / _PAGE,
            table=self.folder / _TABLE,
        )

    def _copied(self, found: _Found) -> tuple[Path, str]:
        """Copy a checkpoint: a training may replace or remove it while trials run."""
        from nw_base.files.cache import atomic_path

        try:
            content = regular(found.path).read_bytes()
        except OSError as error:
            raise StoreError(f"cannot read {found.path}: {error.strerror}") from error
        digest = hashlib.sha256(content).hexdigest()
        name = re.sub(r"[^A-Za-z0-9_.]+", "-", found.path.stem)[:60]
        kept = f"{found.step:09d}-{name}-{digest[:8]}{found.path.suffix}"
        copy = self.folder / "checkpoints" / kept
        with atomic_path(copy) as temporary:
            temporary.write_bytes(content)
        return copy, digest

    def _judged(self, checkpoint: Path, folder: Path, step: int) -> RunReport | None:
        """Run all trials of a checkpoint, or those that are missing, and judge them.

        None if a signal came while the baseline of the best before it was saved.
        """
        from nw_eval.api.continuing import continued
        from nw_eval.api.limit_climbs import climb_limits
        from nw_eval.api.loaded_baselines import opened_baseline
        from nw_eval.api.plans import plan
        from nw_eval.api.reports import as_begun, judge
        from nw_eval.api.runs import judged, roll_out
        from nw_gate.results.journal import has_begun
        from nw_gate.results.labels import fitting
        from nw_sim.rollout.confined.start import prepare

        begun = has_begun(folder / "journal.jsonl")
        request = replace(self.request, checkpoint=checkpoint, baseline="none")
        own = replace(request, suite=None) if begun else request
        training = _printable(Path(self.training.resolve().name))
        labels = fitting({"training_run": training, "step": str(step)})
        if not own.allow_code:
            prepare()
        planned = continued(folder, own) if begun else plan(own)
        ran = roll_out(
            planned,
            replace(self.how, labels=labels),
            out=None if begun else folder,
            resume=folder if begun else None,
            ladders=False,
        )
        try:
            baseline = self._baseline()
        except KeyboardInterrupt:  # What it had of the baseline is kept, and so is the run.
            return None
        against = None if baseline is None else opened_baseline(baseline)
        climb_limits(planned, ran, self.how, searched=True, against=against)

        def against_best(run: Path) -> RunReport:
            found = as_begun(run)
            if baseline is None or found.verdict.verdict in {"INFRASTRUCTURE", "INVALID"}:
                return found
            return judge(run, baseline=str(baseline))

        return judged(ran, how=against_best)  # Its pages are written once.

    def _best(self) -> WatchedCheckpoint | None:
        """Return the checkpoint with the largest mean success; of equal ones, the first."""
        known = [each for each in self._state.checkpoints if each.success is not None and each.run]
        return max(known, key=lambda each: each.success or 0.0, default=None)

    def _baseline(self) -> Path | None:
        """Return the baseline of the best checkpoint so far, or None.

        The run by which it was chosen overstates it: of fifty equal checkpoints the best one is so
        by luck, and others would look worse than it (docs/how-to/watch.md). So its baseline is
        of starts that took no part in choosing it, and is saved when it is first compared with.
        """
        from nw_eval.api.baselines_saved import save_baseline
        from nw_gate.results.provenance import read_run_info
        from nw_gate.results.run_folder import RunFolder

        best = self._best()
        # One that scores less than `max_drop` cannot drop by so much.
        if best is None or best.success is None or not best.success > self._most_drop:
            return None
        assert self.request.suite is not None, "a watch is of a suite"
        key, root = Path(best.run).name, self.folder / "baselines"
        scenes = read_run_info(RunFolder(path=self.folder / best.run).run_json).scenes
        starts = STARTS if len(scenes) > _FEW_SCENES else STARTS_OF_FEW
        [checkpoint] = (self.folder / "checkpoints").glob(f"{key}.*")
        request = self.request
        if not any(root.rglob(f"{key}.parquet")):
            self.how.told.message(
                f"step {best.step} is the best so far, and is compared with from now on: its "
                f"baseline has {starts} initial states per scene that took no part in choosing it"
            )
        return save_baseline(
            self.request.suite,
            policy=request.policy,
            trials=starts,
            name=key,
            note=f"the best of {self.training.name} so far",
            held_out=True,
            root=root,
            workers=self.how.workers,
            cache=self.how.cache,
            listener=self.how.listener,
            checkpoint=checkpoint,
            **{name: getattr(request, name) for name in _OF_BASELINES},
        ).file

    def _with_verdict(
        self, made: WatchedCheckpoint, judged: RunReport, key: str
    ) -> WatchedCheckpoint:
        verdict, best = judged.verdict, self._best()
        against = verdict.against
        bounds = None if against is None else against.interval
        return replace(
            made,
            run=f"runs/{key}",
            verdict=verdict.verdict,
            success=verdict.success,
            low=None if verdict.success is None else verdict.interval.low,
            high=None if verdict.success is None else verdict.interval.high,
            trials=verdict.n,
            completed=verdict.completed,
            against=None if against is None or best is None else best.step,
            drop=None if against is None else against.drop,
            drop_low=None if bounds is None else bounds.low,
            drop_high=None if bounds is None else bounds.high,
            drop_trials=0 if against is None else against.trials,
            scores={item.spec.name: item.mean for item in verdict.scores if item.mean is not None},
            limits={
                item.ladder: tuple(
                    None if bound is None else bound.value
                    for bound in (item.candidate.lower, item.candidate.upper)
                )
                for item in verdict.limits
                if item.candidate is not None
            },
        )

    def _publish(self, judged: RunReport, step: int) -> None:
        from nw_eval.api.reports import TrainingStep
        from nw_eval.api.surfaces import publish

        judged = replace(judged, training=TrainingStep(step=step, folder=self.folder))
        for warning in publish(judged, self.where).warnings:
            self.how.told.message(f"warning: {warning}")

    def _ordered(self) -> Iterator[WatchedCheckpoint]:
        yield from sorted(self._state.checkpoints, key=lambda each: each.step)

    def _write(self) -> None:
        """Write state, table and page.

        Raises:
            StoreError: one cannot be written.
        """
        from nw_base.files.cache import atomic_path
        from nw_eval.reporting.html.training import render_training

        ordered, best = list(self._ordered()), self._best()
        with atomic_path(self.folder / _STATE) as temporary:
            temporary.write_text(f"{json.dumps(asdict(self._state), indent=1)}\n", encoding="utf-8")
        _write_table(self.folder / _TABLE, ordered)
        with atomic_path(self.folder / _PAGE) as temporary:
            page = render_training(
                self.training.resolve().name,
                self._state.suite.partition(" ")[0],
                [asdict(each) for each in ordered],
                best=None if best is None else best.step,
                confidence=self._confidence,
                obstacles=self.obstacles,
                ladders=self._ladders,
            )
            temporary.write_text(page, encoding="utf-8")


def _obstacles(request: Request) -> tuple[str, ...]:
    """Return why no checkpoint can PASS beside one that never fails.

    What is wrong with the suite or its scenes, the first run tells.
    """
    from nw_base.errors import NwEvalError
    from nw_eval.api.plans import Faults, chosen_scenes, open_scenes
    from nw_eval.engine.plan import obstacles_among_equals
    from nw_eval.suite import draft_suite
    from nw_eval.suite.model import override

    assert request.suite is not None, "a watch is of a suite"
    draft = draft_suite(request.suite)
    if draft.suite is None:
        return ()
    try:
        suite = override(draft.suite, request)
        found = open_scenes(draft, Faults(draft), request.collision)
        names = [
            found_scene.scene.name for found_scene in chosen_scenes(found, request.scenes, suite)
        ]
        left_out = {found_scene.scene.name for found_scene in found} - {*names}
        return obstacles_among_equals(suite, names, left_out)
    except NwEvalError:
        return ()


def _sha256(path: Path) -> str:
    with regular(path).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _read_state(path: Path) -> _State | None:
    """Return what an earlier watch in this folder found; None without one.

    Raises:
        StoreError: it is damaged.
    """
    from pydantic import TypeAdapter

    from nw_base.files.inside import bounded_bytes

    if not path.exists():
        return None
    try:
        return TypeAdapter(_State).validate_json(bounded_bytes(path, _MOST_STATE))
    except (OSError, ValueError) as error:
        raise StoreError(
            f"{path} is damaged: {str(error).splitlines()[0]}", fix="choose another --out"
        ) from None


def _write_table(path: Path, checkpoints: Sequence[WatchedCheckpoint]) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    from nw_base.files.cache import atomic_path

    number, count = pa.float64(), pa.int64()
    types = {
        "step": count,
        "against": count,
        "trials": count,
        "completed": count,
        "drop_trials": count,
        **dict.fromkeys(("success", "low", "high", "drop", "drop_low", "drop_high"), number),
        "scores": pa.map_(pa.string(), number),
        "limits": pa.map_(pa.string(), pa.list_(number)),
    }
    schema = pa.schema(
        [(each.name, types.get(each.name, pa.string())) for each in fields(WatchedCheckpoint)]
    )
    maps = ("scores", "limits")
    rows = [
        {**asdict(each), **{name: list(getattr(each, name).items()) for name in maps}}
        for each in checkpoints
    ]
    table = pa.Table.from_pylist(rows, schema=schema)
    with atomic_path(path) as temporary:
        pq.write_table(table, temporary)
