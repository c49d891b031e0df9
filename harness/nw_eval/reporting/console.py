"""The end of a run in the terminal: the report's first tables, drawn by rich."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from nw_base.clean import clean
from nw_base.plural import plural
from nw_eval.reporting.headline import blind_spot, headline
from nw_eval.reporting.tables import all_tables
from nw_eval.reporting.tables.run import taken_over
from nw_eval.reporting.tables.table import Table
from nw_gate.results.provenance import RunInfo
from nw_gate.results.row import Row
from nw_gate.verdict import Verdict, Word

if TYPE_CHECKING:
    from rich.console import Console

_COLOURS: dict[Word, str] = {
    "PASS": "bold green",
    "RAN": "bold blue",
    "REGRESSED": "bold red",
    "INCONCLUSIVE": "bold yellow",
    "INFRASTRUCTURE": "bold magenta",
    "INVALID": "bold magenta",
}


_LINES = 64
"""Of a table that are shown; as many as there are built-in scenes."""


def print_summary(
    console: Console, run: RunInfo, rows: Sequence[Row], verdict: Verdict, folder: Path
) -> None:
    """Print scenes, outcomes, worst trials and times; the verdict last, where eyes are.

    Args:
        console: where to; its width is respected, and colours if it has any.
        run: the run's provenance.
        rows: one for each trial, in any order.
        verdict: what the gate says of them.
        folder: the run's folder as a reader would type it.
    """
    print_tables(console, run, rows, verdict, folder)
    print_verdict(console, run, rows, verdict)


def print_tables(
    console: Console, run: RunInfo, rows: Sequence[Row], verdict: Verdict, folder: Path
) -> None:
    """Print the tables of a summary; arguments as of `print_summary`."""
    for table in all_tables(run, rows, verdict, folder, brief=True):
        draw(console, table)


def print_verdict(console: Console, run: RunInfo, rows: Sequence[Row], verdict: Verdict) -> None:
    """Print the verdict, what it speaks of and rests on; arguments as of `print_summary`."""
    console.print(headline(verdict, run), style=_COLOURS[verdict.verdict], markup=False)
    console.print(blind_spot(verdict, run), markup=False, highlight=False)
    if taken_over(run, rows):
        console.print(taken_over(run, rows), markup=False, highlight=False)
    for reason in verdict.reasons:
        console.print(f"* {_foldable(clean(reason))}", markup=False, highlight=False)


def draw(console: Console, table: Table) -> None:
    """Draw a table, and beneath it what of it is to be typed."""
    from rich import box
    from rich.table import Table as RichTable
    from rich.text import Text

    drawn = RichTable(title=table.title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    shown = [name for name in table.columns if name not in table.code]
    for name in shown:
        drawn.add_column(
            name,
            justify="right" if name in table.numbers else "left",
            overflow="fold",  # A name that is cut short names nothing.
            no_wrap=name == table.columns[0] or _is_one_word(name, table),
        )
    for row in table.rows[:_LINES]:
        cells = dict(zip(table.columns, row, strict=True))
        drawn.add_row(*(Text(_foldable(cells[name])) for name in shown))
    console.print(drawn)
    if table.foot:
        console.print(table.foot, markup=False, highlight=False)
        console.print()
    if (more := len(table.rows) - _LINES) > 0:
        console.print(f"{plural(more, 'more line')} in the report", style="dim", highlight=False)
    # Something to type must stay on one line, uncut: beneath the table, not in a column.
    for name in table.columns:
        if name in table.code:
            for row in table.rows:
                if command := dict(zip(table.columns, row, strict=True))[name]:
                    console.print(command, markup=False, highlight=False, soft_wrap=True)
            console.print()


_SHORT = 12
"""Characters of a word that is not folded, as `supporting` is none that may be."""


def _is_one_word(name: str, table: Table) -> bool:
    """Whether a column's header and cells are short words, which make no sense folded."""
    place = table.columns.index(name)
    cells = (name, *(row[place] for row in table.rows))
    return all(len(cell) <= _SHORT and " " not in cell for cell in cells)


def _foldable(text: str) -> str:
    """Return a cleaned text that may be folded anywhere: no part of it is an order to a CI runner.

    `::error::` is one at the start of a line, and a folded line starts in the middle of the text.
    """
    return re.sub(r"::(?=[A-Za-z-]+\b.*::)", r"\\x3a:", text)
