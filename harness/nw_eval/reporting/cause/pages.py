"""The page of a cause: `cause.md`."""

from __future__ import annotations

from pathlib import Path

from nw_eval.gate.cause import Cause
from nw_eval.reporting.cause.words import cause_table
from nw_eval.reporting.markdown import escaped, markdown_table, write_report


def write_cause(cause: Cause, run: str, path: Path) -> None:
    """Write the page.

    Raises:
        StoreError: it cannot be written.
    """
    table = cause_table(cause)
    parts = [f"# {escaped(table.title)}: {escaped(run)}", markdown_table(table)]
    write_report(path, "\n\n".join([*parts, escaped(table.note)]) + "\n")
