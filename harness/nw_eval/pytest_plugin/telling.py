"""What a session of pytest shows of suites.

A failing test shows the verdict, the table and the replay command, the reason first; a JUnit test
case has properties besides; and each suite has a line at the end of the session, wherever its tests
ran.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from io import StringIO
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from nw_eval.api import RunReport
    from nw_eval.reporting.scene_states import SceneState
    from nw_eval.reporting.tables.table import Table
    from nw_eval.results.row import Row


_WIDTH = 10_000
"""Columns: a sentence stays on its line, whose first one stands in summaries and in JUnit."""


def verdict_text(judged: RunReport) -> str:
    """Return the verdict with its reasons, every scene, the worst trials, and where the page is."""
    from nw_eval.reporting.tables.scenes import scenes_table

    return _text(judged, [scenes_table(judged.verdict, brief=True)], judged.rows)


def scene_text(judged: RunReport, state: SceneState) -> str:
    """Return what became of one scene, the verdict, and the scene's lines of its tables."""
    from nw_eval.clean import clean
    from nw_eval.reporting.tables.scenes import scenes_table

    verdict = replace(judged.verdict, per_scene=(state.score,))
    if verdict.against is not None:
        verdict = replace(verdict, against=replace(verdict.against, scenes=state.drops))
    # The note speaks of all scenes.
    alone = [replace(scenes_table(verdict, brief=True), note="")]
    rows = [row for row in judged.rows if row.scene == state.scene]
    return f"{clean(state.scene)}: {clean(state.sentence)}\n{_text(judged, alone, rows)}"


def _text(judged: RunReport, tables: Sequence[Table], rows: Sequence[Row]) -> str:
    from rich.console import Console

    from nw_eval.reporting.console import draw, print_verdict
    from nw_eval.reporting.tables.trials import errors_table, worst_table

    stream = StringIO()
    console = Console(file=stream, width=_WIDTH, force_terminal=False, no_color=True)
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
            lines[suite] = f"{properties['headline']} · report: {properties['report']}"
    if lines and terminal.config.get_verbosity() >= 0:
        terminal.write_sep("-", "nw-eval")
        for suite, line in sorted(lines.items()):
            terminal.write_line(f"{suite}: {line}")
