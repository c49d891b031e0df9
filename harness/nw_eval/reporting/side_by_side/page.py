"""A comparison of policies as a page of Markdown."""

from __future__ import annotations

from nw_eval.gate.side_by_side import PolicyComparison
from nw_eval.reporting.markdown import escaped, markdown_table
from nw_eval.reporting.side_by_side.tables import comparison_tables


def comparison_page(found: PolicyComparison) -> str:
    """Return the page: each table under its title, with its note."""
    parts: list[str] = []
    for level, table in enumerate(comparison_tables(found)):
        parts += [f"{'##' if level else '#'} {table.title}", markdown_table(table)]
        parts += [escaped(table.note)] if table.note else []
    return "\n\n".join(parts) + "\n"
