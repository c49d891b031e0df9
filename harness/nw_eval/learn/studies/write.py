"""The numbers of a study's figure, for programs and for people."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pyarrow as pa

from nw_eval.plural import plural
from nw_eval.reporting.markdown import escaped, markdown_table, write_report
from nw_eval.results.tables.sealed import write_table

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from nw_eval.learn.studies.scores import Score
    from nw_eval.reporting.tables import Table

_SCHEMA = pa.schema(
    [
        ("student", pa.string()),
        ("round", pa.int64()),
        ("group", pa.string()),
        ("against", pa.string()),
        ("trials", pa.int64()),
        ("errors", pa.int64()),
        ("success", pa.float64()),
        ("low", pa.float64()),
        ("high", pa.float64()),
    ]
)


def write_scores(path: Path, scores: Sequence[Score]) -> None:
    """Write scores as Parquet, a row each; `success`, `low` and `high` are null without results.

    With `against` they are of differences on the same starts.

    Raises:
        StoreError: the file cannot be written.
    """
    rows = [
        {
            "student": each.student,
            "round": each.round,
            "group": each.group,
            "against": each.against,
            "trials": 0 if each.estimate is None else each.estimate.n,
            "errors": each.errors,
            "success": None if each.estimate is None else each.estimate.mean,
            "low": None if each.estimate is None else each.estimate.interval.low,
            "high": None if each.estimate is None else each.estimate.interval.high,
        }
        for each in scores
    ]
    write_table(path, pa.Table.from_pylist(rows, schema=_SCHEMA), {})


def write_page(path: Path, tables: Sequence[Table]) -> None:
    """Write tables as a page of Markdown, the first one's title on top.

    Raises:
        StoreError: the file cannot be written.
    """
    parts: list[str] = []
    for level, table in enumerate(tables):
        parts += [f"{'##' if level else '#'} {escaped(table.title)}", markdown_table(table)]
        parts += [escaped(table.note)] if table.note else []
    write_report(path, "\n\n".join(parts) + "\n")


def cell(score: Score | None) -> str:
    """Return a score as a cell: its value, its interval, its trials."""
    if score is None or score.estimate is None:
        return "none" if score is not None and score.errors else ""
    found = score.estimate
    sign = "+z" if score.against else ""
    low, high = found.interval
    text = f"{found.mean:{sign}.2f} ({low:{sign}.2f} to {high:{sign}.2f}), {found.n}"
    return f"{text}, {plural(score.errors, 'error')}" if score.errors else text
