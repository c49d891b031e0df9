"""The report within a budget of bytes: the worst scenes first, and how many more there are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from nw_eval.errors import StoreError
from nw_eval.gate.verdict import Verdict
from nw_eval.reporting.markdown import render_page
from nw_eval.reporting.tables import Table, all_tables
from nw_eval.results.provenance import RunInfo
from nw_eval.results.row import Row

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
