"""The text of a comment on a pull request: one for each suite, known again by a hidden mark."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from nw_eval.gate.verdict import Verdict
from nw_eval.reporting.github.summary import summary_page
from nw_eval.results.provenance import RunInfo
from nw_eval.results.row import Row

_BUDGET = 60_000
"""Bytes, hence characters at most; GitHub takes 65,536, and whoever posts it adds some lines."""

_ROWS, _TABLES = 20, 1
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
    page = summary_page(run, rows, verdict, folder, budget=_BUDGET, most=_ROWS, unfolded=_TABLES)
    return f"<!-- nw-eval: {run.suite.get('name', 'suite')} -->\n{page}"
