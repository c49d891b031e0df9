"""The runs of a session, each made once, what the fixtures give of them, and what is shown of them.

One run serves all tests that ask for it, in whichever worker of pytest-xdist. A failing test shows
the verdict, the table and the replay command, the reason first; a JUnit test case has properties
besides; and each suite has a line at the end of the session, wherever its tests ran.
"""

from __future__ import annotations

import sys
from collections.abc import Generator, Iterable, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from hashlib import sha256
from io import StringIO
from logging import getLogger
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import pytest

from nw_base.clean import clean
from nw_base.errors import NwEvalError, StoreError
from nw_eval.pytest_plugin.options import SETTINGS

if TYPE_CHECKING:
    from nw_eval.api import Request, RunReport
    from nw_eval.reporting.scene_states import SceneState
    from nw_eval.reporting.tables.table import Table
    from nw_gate.results.row import Row


_SESSION = "nw_eval_session"
"""Where xdist's controller names the session, among all that it tells a worker."""

_NAME = pytest.StashKey[str]()

_LOGGER = getLogger("nw_eval")


def tell_worker(config: pytest.Config, workerinput: dict[str, Any]) -> None:
    """Tell a worker of pytest-xdist which session it works for."""
    workerinput[_SESSION] = config.stash.setdefault(_NAME, _name_session())


def runs_of(config: pytest.Config) -> Runs:
    """Return the runs of a session."""
    if _RUNS not in config.stash:
        config.stash[_RUNS] = Runs(config)
    return config.stash[_RUNS]


def _name_session() -> str:
    """Return a name for a session that no other one has: its time, UTC, and chance."""
    return f"{datetime.now(tz=UTC):%Y%m%dT%H%M%SZ} {uuid4().hex}"


class Runs:
    """The runs of a session, each of which is made when it is first asked for, and once."""

    def __init__(self, config: pytest.Config) -> None:
        self._settings = config.stash[SETTINGS]
        worker: dict[str, Any] | None = getattr(config, "workerinput", None)
        self._sharing = 0 if worker is None else int(worker["workercount"])
        self._session = _name_session() if worker is None else str(worker[_SESSION])
        self._known: dict[tuple[Path, Request], RunReport | NwEvalError] = {}

    def of(self, request: Request) -> RunReport:
        """Return the run of a request in the working folder.

        Raises:
            NwEvalError: it came to no verdict; however often one asks.
            KeyboardInterrupt: it was interrupted.
        """
        key = (Path.cwd(), request)
        if key not in self._known:
            try:
                self._known[key] = self._run(request)
            except NwEvalError as error:
                self._known[key] = error
        known_run = self._known[key]
        if isinstance(known_run, NwEvalError):
            raise known_run.with_traceback(None)
        return known_run

    def _run(self, request: Request) -> RunReport:

        folder = self._settings.report_dir / self._name(request)
        if not self._sharing:
            judged = self._begin(request, out=folder)
        else:
            with locked(folder / "pytest.lock"):
                judged = self._join(request, folder)
        if judged.interrupted and judged.verdict.verdict == "INFRASTRUCTURE":
            raise KeyboardInterrupt(
                f"interrupted; continue with nw-eval run --resume {judged.typed_folder}"
            )
        return judged

    def _join(self, request: Request, folder: Path) -> RunReport:
        """Return the run that another worker has made, or go on where it died over it."""
        from nw_eval import api

        if not (folder / "run.json").is_file():
            return self._begin(request, out=folder)
        judged = api.report(folder)
        return judged if judged.info.finished else self._begin(request, resume=folder)

    def _begin(
        self, request: Request, *, out: Path | None = None, resume: Path | None = None
    ) -> RunReport:
        from nw_eval import api

        return api.run(
            request,
            workers=self._workers,
            out=out,
            resume=resume,
            cache=self._settings.cache,
            listener=Log(),
        )

    @property
    def _workers(self) -> int | None:
        """Processes for trials: this worker's share of the cores, where it is one of several."""
        if self._settings.workers is not None or not self._sharing:
            return self._settings.workers
        from nw_gate.results.provenance import usable_cores

        return max(1, usable_cores() // self._sharing)

    def _name(self, request: Request) -> str:
        """Return the name of a run's folder, which is the same for every worker."""
        time, chance = self._session.split()
        mark = sha256(f"{chance} {Path.cwd()} {request}".encode()).hexdigest()[:8]
        name = Path(str(request.suite)).name.partition(".")[0]
        return f"{name}-{time}-{mark}"


_RUNS = pytest.StashKey[Runs]()


@contextmanager
def locked(file: Path) -> Generator[None]:
    """Wait for a file's lock, and hold it.

    The kernel holds it for this process alone, whatever children it starts: it ends with the
    process, however that ends.

    Raises:
        StoreError: the file cannot be made.
    """
    import fcntl

    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        handle = file.open("a", encoding="utf-8")
    except OSError as error:
        raise StoreError(
            f"cannot make {file}: {error.strerror}",
            fix="choose another folder with --nw-report-dir",
        ) from error
    with handle:
        fcntl.lockf(handle, fcntl.LOCK_EX)
        yield


class Log:
    """A listener that logs: `pytest --log-cli-level=INFO` shows its lines as they come."""

    def __init__(self) -> None:
        self._total = self._finished = 0

    def message(self, text: str) -> None:
        """Log a line for people."""
        _LOGGER.info("%s", clean(text))

    def scene(self, name: str, fraction: float) -> None:
        """Log that a scene's splat is made."""
        if fraction >= 1.0:
            _LOGGER.info("%s is ready", clean(name))

    def planned(self, *, total: int, finished: int) -> None:
        """Log how many trials there are."""
        self._total, self._finished = total, finished
        _LOGGER.info("%d of %d trials to run", total - finished, total)

    def trial(self, row: Row) -> None:
        """Log how a trial ended."""
        self._finished += 1
        _LOGGER.info(
            "%d of %d: %s %s", self._finished, self._total, clean(row.trial_id), row.outcome
        )


@dataclass(frozen=True, kw_only=True)
class Gated:
    """What a gate says."""

    report: RunReport
    passed: bool
    """Whether the verdict is PASS; or INCONCLUSIVE, in a session that lets that pass."""

    def __repr__(self) -> str:
        """Return what a failing `assert` is to show: the verdict with its figures."""
        from nw_eval.reporting.headline import headline

        return headline(self.report.verdict, self.report.info)


class RunSuite:
    """Runs suites for tests; each run is made once in a session.

    Args:
        config: of the session, whose options hold for what a call leaves out.
    """

    def __init__(self, config: pytest.Config) -> None:
        self._config = config

    def __call__(self, suite: str | Path, **changes: Any) -> RunReport:
        """Run a suite, or return its run.

        Args:
            suite: a file, or the name of a shipped one.
            changes: fields of `nw_eval.Request` by name.
        """
        from nw_eval import api

        settings = self._config.stash[SETTINGS]
        options = {
            "policy": settings.policy,
            "checkpoint": settings.checkpoint,
            "baseline": settings.baseline,
            "trials": settings.rounds,
        }
        try:
            request = api.Request.of(suite, **{**options, **changes})
            return runs_of(self._config).of(request)
        except NwEvalError as error:
            fault = str(error)
        pytest.fail(fault, pytrace=False)


class GateSuite:
    """Gates policies for tests, with the runs of `RunSuite`.

    Args:
        config: of the session.
    """

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._run = RunSuite(config)

    def __call__(self, suite: str | Path, **changes: Any) -> Gated:
        """Run a suite, or take its run, and return what its gate says.

        A test fails here if there is nothing to say: trials without a result, a baseline that does
        not hold, a suite without a gate. The text of a verdict that does not pass is printed, which
        pytest shows with the test that fails.

        Args:
            suite: a file, or the name of a shipped one.
            changes: fields of `nw_eval.Request` by name.
        """
        judged = self._run(suite, **changes)
        word = judged.verdict.verdict
        if word in {"INFRASTRUCTURE", "INVALID", "RAN"}:
            pytest.fail(verdict_text(judged), pytrace=False)
        gated = Gated(report=judged, passed=judged.passed)
        if word == "INCONCLUSIVE":
            inconclusive = self._config.stash[SETTINGS].inconclusive
            if inconclusive == "xfail":
                pytest.xfail(repr(gated))
            gated = Gated(report=judged, passed=inconclusive == "pass")
        if not gated.passed:
            sys.stdout.write(verdict_text(judged) + "\n")
        return gated


_WIDTH = 10_000
"""Columns: a sentence stays on its line, whose first one stands in summaries and in JUnit."""


def verdict_text(judged: RunReport) -> str:
    """Return the verdict with its reasons, every scene, the worst trials, and where the page is."""
    from nw_eval.reporting.tables.scenes import scenes_table

    return _text(judged, [scenes_table(judged.verdict, brief=True)], judged.rows)


def scene_text(judged: RunReport, state: SceneState, *, with_verdict: bool) -> str:
    """Return the result of one scene, the verdict if asked for, and the scene's table lines."""
    from nw_base.clean import clean
    from nw_eval.reporting.tables.scenes import scenes_table

    verdict = replace(judged.verdict, per_scene=(state.score,))
    if verdict.against is not None:
        verdict = replace(verdict, against=replace(verdict.against, scenes=state.drops))
    # The note speaks of all scenes.
    alone = [replace(scenes_table(verdict, brief=True), note="")]
    rows = [row for row in judged.rows if row.scene == state.scene]
    text = _text(judged, alone, rows, with_verdict=with_verdict)
    return f"{clean(state.scene)}: {clean(state.sentence)}\n{text}"


def _text(
    judged: RunReport, tables: Sequence[Table], rows: Sequence[Row], *, with_verdict: bool = True
) -> str:
    from rich.console import Console

    from nw_eval.reporting.console import draw, print_verdict
    from nw_eval.reporting.tables.trials import errors_table, worst_table

    stream = StringIO()
    console = Console(file=stream, width=_WIDTH, force_terminal=False, no_color=True)
    if with_verdict:
        print_verdict(console, judged.info, judged.rows, judged.verdict)
    ordered = sorted(rows, key=lambda row: row.trial_id)
    for table in (*tables, errors_table(ordered), worst_table(ordered, judged.typed_folder, 3)):
        if table.rows:
            console.print()
            draw(console, replace(table, note=""))
    if judged.typed_page is not None:
        both = "" if judged.html is None else f" and {judged.html.name}"
        line = f"report: {judged.typed_page}{both}"
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    return "\n".join(line.rstrip() for line in stream.getvalue().splitlines())


_Properties = list[tuple[str, object]]


def verdict_properties(judged: RunReport) -> _Properties:
    """Return those of the verdict: its figures, where they come from, and where the page is."""
    from nw_eval.reporting.headline import headline
    from nw_eval.reporting.junit import run_properties

    return [
        *run_properties(judged.info, judged.verdict).items(),
        ("headline", headline(judged.verdict, judged.info)),
        ("report", str(judged.typed_page or judged.typed_folder)),
    ]


def scene_properties(judged: RunReport, state: SceneState) -> _Properties:
    """Return those of a scene: its figures, and those of the run that they come from."""
    from nw_eval.reporting.junit import scene_properties as of_scene
    from nw_eval.reporting.tables.trials import worst_trials

    rows = [row for row in judged.rows if row.scene == state.scene]
    return [
        *of_scene(state, rows, worst_trials(rows)).items(),
        ("run", judged.info.id),
        ("report", str(judged.typed_page or judged.typed_folder)),
    ]


def write_last_lines(
    terminal: pytest.TerminalReporter, verdicts: Iterable[pytest.TestReport]
) -> None:
    """Write each suite's verdict and where its page is.

    Args:
        terminal: where to.
        verdicts: reports of verdicts' tests, and of whatever else is called like them.
    """
    lines: dict[str, str] = {}
    for report in verdicts:
        properties = dict(report.user_properties)
        if "headline" in properties:
            suite = report.nodeid.removesuffix("::verdict")
            # A verdict that failed has shown its headline already.
            shown = properties["headline" if report.passed else "verdict"]
            lines[suite] = f"{shown} · report: {properties['report']}"
    if lines and terminal.config.get_verbosity() >= 0:
        terminal.write_sep("-", "nw-eval")
        for suite, line in sorted(lines.items()):
            terminal.write_line(f"{suite}: {line}")
