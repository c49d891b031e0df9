"""Policies side by side, as lines of text."""

from __future__ import annotations

from textwrap import fill
from typing import TYPE_CHECKING

from nw_eval.cli.text.table import aligned

if TYPE_CHECKING:
    from nw_eval.gate.side_by_side.result import PolicyComparison

_WIDTH = 100


def comparison_text(found: PolicyComparison) -> str:
    """Return the tables of a comparison, each with its title and its note."""
    from nw_eval.reporting.side_by_side.tables import comparison_tables

    parts: list[str] = []
    for table in comparison_tables(found):
        right = [place for place, name in enumerate(table.columns) if name in table.numbers]
        lines = aligned([table.columns, *table.rows], right=right)
        note = [fill(table.note, _WIDTH)] if table.note else []
        parts.append("\n".join([table.title, "", *lines, *([""] if note else []), *note]))
    return "\n\n".join(parts)
