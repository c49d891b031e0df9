"""report.md: the verdict first, then the evidence. Reads rows and run.json only."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from nw_eval.clean import clean
from nw_eval.files.cache import atomic_path
from nw_eval.gate.verdict import Verdict
from nw_eval.reporting.certainty import how_sure
from nw_eval.reporting.headline import blind_spot, headline
from nw_eval.reporting.tables import Table, all_tables
from nw_eval.results.provenance import RunInfo
from nw_eval.results.row import Row

_LONGEST = 4000  # characters of a line or a cell


def render_markdown(run: RunInfo, rows: Sequence[Row], verdict: Verdict, folder: Path) -> str:
    """Return the report.

    Args:
        run: the run's provenance.
        rows: one for each trial, in any order.
        verdict: what the gate says of them.
        folder: the run's folder as a reader would type it; replay commands start with it.
    """
    # Markdown, not HTML: `_text` escapes what would break a table.
    environment = Environment(  # noqa: S701
        loader=PackageLoader("nw_eval.reporting"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["text"] = _text
    return environment.get_template("report.md.j2").render(
        headline=headline(verdict, run),
        blind_spot=blind_spot(verdict, run),
        reasons=verdict.reasons,
        interrupted=run.interrupted,
        how_sure=how_sure(verdict, run),
        tables=[(table, markdown_table(table)) for table in all_tables(run, rows, verdict, folder)],
    )


def write_report(path: Path, text: str) -> None:
    """Write a report, whole or not at all.

    Raises:
        StoreError: it cannot be written.
    """
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def markdown_table(table: Table) -> str:
    """Return a table in GitHub's Markdown, padded so that it reads as plain text too."""
    cells = [[_text(name) for name in table.columns]]
    cells += [
        [
            _code(cell) if name in table.code else _text(cell)
            for name, cell in zip(table.columns, row, strict=True)
        ]
        for row in table.rows
    ]
    widths = [max(3, *(len(line[index]) for line in cells)) for index in range(len(table.columns))]
    right = [name in table.numbers for name in table.columns]
    rule = ["-" * (width - 1) + ("-:"[flag]) for width, flag in zip(widths, right, strict=True)]
    lines = [
        [
            cell.rjust(width) if flag else cell.ljust(width)
            for cell, width, flag in zip(line, widths, right, strict=True)
        ]
        for line in cells
    ]
    lines.insert(1, rule)
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


_ACTS = re.compile(r"@\w|#\d|\bgh-\d|://|\bwww\.", re.IGNORECASE)
"""What GitHub makes a mention, a reference or a link of, wherever it stands in a word."""


def _text(words: str) -> str:
    """Return words from anywhere (an error's text, a name) as one line of harmless Markdown.

    A word that would notify somebody or become a link is set as code, where it does neither; no
    backslash keeps GitHub from that. Underscores within words start no emphasis in GitHub's
    Markdown, and names are full of them.
    """
    return " ".join(
        _code(word) if _ACTS.search(word) else re.sub(r"([\\`*\[\]<>|~$&])", r"\\\1", word)
        for word in clean(words, at_most=_LONGEST).split()
    )


def _code(words: str) -> str:
    line = clean(words, at_most=_LONGEST).replace("|", "\\|").replace("`", "'")
    return f"`{line}`" if line else ""
