"""A sweep, as lines of text."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nw_eval.cli.text.table import aligned

if TYPE_CHECKING:
    from nw_eval.api import SweptSuite


def sweep_text(found: SweptSuite) -> str:
    """Return the tables of a sweep, what they say, and where its files are."""
    from nw_eval.reporting.sweep.pages import sweep_words
    from nw_eval.reporting.sweep.words import sweep_table

    parts: list[str] = []
    for curves in found.axes:
        table = sweep_table(curves)
        right = [place for place, name in enumerate(table.columns) if name in table.numbers]
        parts.append("\n".join(aligned([table.columns, *table.rows], right=right)))
        parts.append("\n".join(sweep_words(curves)))
    if found.axes:
        parts.append("\n".join(str(found.out / f"sweep.{end}") for end in ("md", "png", "parquet")))
    return "\n\n".join(parts)
