"""What GitHub's runner reads of a run: commands in the log, files of the step, a comment.

Beside lines of a suite GitHub shows the verdict and its worst scenes, at most eight. The summary
and the comment on a pull request are the report within a budget of bytes, the worst scenes first;
a comment is known again, one for each suite, by a hidden mark.

Sizes and limits are those of docs.github.com, *Workflow commands for GitHub Actions*: 1 MiB of step
summary, above which all of it is lost; 10 annotations of a kind and step, of which the rest vanish
without a word; 65,536 characters of a comment. A command is `::name key=value,key=value::message`,
escaped as the runner's own toolkit escapes it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path

from nw_base.clean import clean
from nw_base.errors import NwEvalError, Problem, StoreError
from nw_eval.reporting.headline import headline
from nw_eval.reporting.markdown import render_page
from nw_eval.reporting.scene_states import SceneState, SuiteLines, scene_states, worst_first
from nw_eval.reporting.tables import all_tables
from nw_eval.reporting.tables.table import Table
from nw_gate.results.provenance import RunInfo
from nw_gate.results.row import Row
from nw_gate.verdict import Verdict

MOST = 8
"""Annotations of a run. GitHub shows ten of a kind and step, and drops others without a word."""


def run_annotations(run: RunInfo, verdict: Verdict, lines: SuiteLines | None) -> tuple[str, ...]:
    """Return commands: an error for a verdict that is no pass, and one for each scene to look at.

    A scene that makes the verdict is an error, one that is weak in a run that passes is a warning.

    Args:
        run: the run's provenance.
        verdict: what the gate says of it.
        lines: where the suite's file speaks of its scenes; None if it is not in the repository.
    """
    suite = run.suite.get("name", "suite")
    shown: list[str] = []
    if verdict.exit_code:
        why = "; ".join([headline(verdict, run), *verdict.reasons[:1]])
        title = f"{verdict.verdict}: {suite}"
        line = None if lines is None else lines.gate
        shown.append(_beside(lines, line, "error", title, why))
    for state in worst_first(scene_states(verdict)):
        if state.state in {"failed", "error", "weak"}:
            line = None if lines is None else lines.scenes.get(state.scene, lines.gate)
            title = f"{_title(state)}: {state.scene}"
            shown.append(_beside(lines, line, _level(state), title, state.sentence))
    return tuple(shown[:MOST])


def error_annotations(error: NwEvalError, root: Path) -> tuple[str, ...]:
    """Return commands for an error that kept a run from a verdict: one for each fault of a file.

    Args:
        error: what happened.
        root: the repository's folder, to which the paths of faults are relative.
    """
    if not error.problems:
        return (command("error", str(error), title="nw-eval"),)
    return tuple(_of_problems(error.problems[:MOST], root))


def _of_problems(problems: Iterable[Problem], root: Path) -> Iterable[str]:
    for problem in problems:
        path = Path(problem.file).resolve()
        here = path.is_relative_to(root.resolve())
        yield command(
            "error",
            str(problem),
            file=path.relative_to(root.resolve()).as_posix() if here else None,
            line=problem.line if here else None,
            col=problem.column if here else None,
            title="nw-eval",
        )


def _title(state: SceneState) -> str:
    """Return what is wrong with a scene; one below the bar did not regress from a baseline."""
    if state.state == "error":
        return "incomplete"
    return "regressed" if any(item.named for item in state.drops) else "below the bar"


def _level(state: SceneState) -> str:
    return "warning" if state.state == "weak" else "error"


def _beside(
    lines: SuiteLines | None, line: int | None, level: str, title: str, message: str
) -> str:
    file = None if lines is None else lines.file
    return command(level, message, file=file, line=line, title=title)


def command(name: str, message: str, **properties: str | int | None) -> str:
    """Return a command as one line; what it says is cleaned, so that nothing in it is another one.

    Args:
        name: such as `error`.
        message: any text.
        properties: such as `file` and `line`; those that are None are left out.
    """
    known = {key: value for key, value in properties.items() if value is not None}
    settings = ",".join(f"{key}={_property(str(value))}" for key, value in known.items())
    return f"::{name}{f' {settings}' if settings else ''}::{_data(message)}"


def begin_group(title: str) -> str:
    """Return the line that folds what follows in the log behind a title."""
    return command("group", title)


END_GROUP = "::endgroup::"
"""The line that ends it."""


def _data(text: str) -> str:
    return clean(text).replace("%", "%25")  # Cleaned, it has no line breaks to escape.


def _property(text: str) -> str:
    return _data(text).replace(":", "%3A").replace(",", "%2C")


SUMMARY = 256 * 2**10
"""Bytes of a run's part of a step summary: four runs of a step have room in GitHub's 1 MiB."""

_ROWS = (1000, 300, 100, 30, 10, 3, 1)
"""Rows of each table that are tried in turn, where all of them are too many."""

_REASONS = 12


def summary_page(
    run: RunInfo,
    rows: Sequence[Row],
    verdict: Verdict,
    folder: Path,
    *,
    budget: int = SUMMARY,
    most: int | None = None,
    unfolded: int | None = None,
) -> str:
    """Return the report, with as many rows of its tables as there is room for.

    Args:
        run: the run's provenance.
        rows: one for each trial, in any order.
        verdict: what the gate says of them.
        folder: the run's folder as a reader would type it.
        budget: bytes of UTF-8 that it may take.
        most: rows of a table, whatever room there is; as many as there are if None.
        unfolded: as for `render_page`.

    Raises:
        StoreError: not even a row of each table has room.
    """
    tables = all_tables(run, rows, verdict, folder)
    longest = max((len(table.rows) for table in tables), default=0)
    at_first = longest if most is None else min(most, longest)
    verdict = _few_reasons(verdict)
    for count in (at_first, *(count for count in _ROWS if count < at_first)):
        shown = [_cut(table, count) for table in tables]
        page = render_page(run, verdict, shown, among_others=True, unfolded=unfolded)
        if len(page.encode()) <= budget:
            return page
    raise StoreError(f"the page needs more than the {budget} bytes that are left for it")


def _cut(table: Table, count: int) -> Table:
    """Return a table with its first rows; what ran on what is short, and stays whole."""
    return table if table.title == "Provenance" else table.first(count, "the run's artifact")


def _few_reasons(verdict: Verdict) -> Verdict:
    more = len(verdict.reasons) - _REASONS
    if more <= 0:
        return verdict
    rest = f"{more} more in the run's artifact"
    return replace(verdict, reasons=(*verdict.reasons[:_REASONS], rest))


_BUDGET = 60_000
"""Bytes, hence characters at most; GitHub takes 65,536, and whoever posts it adds some lines."""

_COMMENT_ROWS, _TABLES = 20, 2
"""Rows of a table, and tables that are not behind a line to click on."""


def comment_page(run: RunInfo, rows: Sequence[Row], verdict: Verdict, folder: Path) -> str:
    """Return the comment on a judged run; its first line is the mark that no reader sees.

    Args:
        run: the run's provenance; a suite's name is of letters, digits, `_`, `.` and `-`.
        rows: one for each trial, in any order.
        verdict: what the gate says of them.
        folder: the run's folder as a reader would type it.

    Raises:
        StoreError: it has no room.
    """
    page = summary_page(
        run, rows, verdict, folder, budget=_BUDGET, most=_COMMENT_ROWS, unfolded=_TABLES
    )
    return f"<!-- nw-eval: {run.suite.get('name', 'suite')} -->\n{page}"


_WHOLE = 1024 * 2**10
"""Bytes of a step's summary, all runs of the step together; GitHub drops a larger one whole."""


@dataclass(frozen=True, kw_only=True)
class Runner:
    """What the environment says of GitHub's runner."""

    summary: Path | None
    output: Path | None
    workspace: Path
    """The folder of the repository."""


def runner_of(environment: Mapping[str, str]) -> Runner:
    """Return what an environment says of GitHub's runner."""

    def path(name: str) -> Path | None:
        return Path(value) if (value := environment.get(name)) else None

    return Runner(
        summary=path("GITHUB_STEP_SUMMARY"),
        output=path("GITHUB_OUTPUT"),
        workspace=path("GITHUB_WORKSPACE") or Path.cwd(),
    )


def room_in(summary: Path | None) -> int:
    """Return how many bytes a step's summary still takes."""
    try:
        size = 0 if summary is None else summary.stat().st_size
    except OSError:  # Not there yet; whether it can be written shows when it is.
        size = 0
    return max(0, _WHOLE - size - 1)


def append(path: Path | None, text: str, variable: str) -> None:
    """Add whole lines to a file of the runner's.

    Args:
        path: the file; None if the environment names none.
        text: lines.
        variable: of the environment, for an error.

    Raises:
        StoreError: there is none, or it cannot be written.
    """
    if path is None:
        raise StoreError(f"the environment has no {variable}", fix="run it as a step of a job")
    try:
        with path.open("a+b") as file:
            size = file.seek(0, 2)
            file.seek(max(0, size - 1))
            begun = file.read(1) not in {b"", b"\n"}  # Somebody's line has no end.
            file.write((b"\n" if begun else b"") + text.encode())
    except OSError as error:
        raise StoreError(f"cannot write {variable}: {error.strerror or error}") from error


def outputs_text(outputs: Mapping[str, str]) -> str:
    """Return outputs as the runner reads them: each between lines that its value cannot hold."""
    return "".join(_output(name, value) for name, value in outputs.items())


def _output(name: str, value: str) -> str:
    # A value does not hold its own digest, so that the same run writes the same file.
    fence = f"nw_eval_{sha256(value.encode(errors='surrogateescape')).hexdigest()}"
    return f"{name}<<{fence}\n{value}\n{fence}\n"
