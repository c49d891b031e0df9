"""What a failing test shows: the verdict, the table and the replay command, the reason first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from io import StringIO
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from nw_eval.api import RunReport
    from nw_eval.reporting.scene_states import SceneState
    from nw_eval.reporting.tables import Table
    from nw_eval.results.row import Row

_WIDTH = 10_000
"""Columns: a sentence stays on its line, whose first one stands in summaries and in JUnit."""


def verdict_text(judged: RunReport) -> str:
    """Return the verdict with its reasons, every scene, the worst trials, and where the page is."""
    from nw_eval.reporting.tables.baseline import baseline_table
    from nw_eval.reporting.tables.success import scenes_table

    verdict = judged.verdict
    tables = (baseline_table(verdict.against, brief=True), scenes_table(verdict))
    return _text(judged, tables, judged.rows)


def scene_text(judged: RunReport, state: SceneState) -> str:
    """Return what became of one scene, the verdict, and the scene's lines of its tables."""
    from nw_eval.clean import clean
    from nw_eval.reporting.tables.baseline import baseline_table
    from nw_eval.reporting.tables.success import scenes_table

    verdict = judged.verdict
    tables = [scenes_table(replace(verdict, per_scene=(state.score,)))]
    if verdict.against is not None:
        tables.insert(0, baseline_table(replace(verdict.against, scenes=state.drops), brief=True))
    # The notes speak of all scenes.
    alone = [replace(table, note="") for table in tables]
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
