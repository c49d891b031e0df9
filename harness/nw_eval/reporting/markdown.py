"""Pages of Markdown: report.md, the verdict first, then the evidence, and cause.md.

They read rows and run.json only, and print words from anywhere as harmless text.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from nw_base.clean import clean
from nw_base.files.cache import atomic_path
from nw_eval.reporting.headline import blind_spot, headline, how_sure, next_step
from nw_eval.reporting.tables import NO_RIVALS, Rivals, all_tables
from nw_eval.reporting.tables.cause import cause_table
from nw_eval.reporting.tables.table import Table
from nw_gate.cause import Cause
from nw_gate.results.provenance import RunInfo
from nw_gate.results.row import Row
from nw_gate.verdict import Verdict

_LONGEST = 4000  # characters of a line or a cell


def render_markdown(
    run: RunInfo,
    rows: Sequence[Row],
    verdict: Verdict,
    folder: Path,
    cause: Cause | None = None,
    rivals: Rivals = NO_RIVALS,
) -> str:
    """Return the report; arguments as of `all_tables`."""
    tables = all_tables(run, rows, verdict, folder, cause=cause, rivals=rivals)
    return render_page(run, verdict, tables)


def render_page(
    run: RunInfo,
    verdict: Verdict,
    tables: Sequence[Table],
    *,
    among_others: bool = False,
    unfolded: int | None = None,
) -> str:
    """Return a page: the verdict, why, the tables, and how sure one may be.

    Args:
        run: the run's provenance.
        verdict: what the gate says of it.
        tables: in their order.
        among_others: whether pages of other runs stand beside it, and its title says whose it is.
        unfolded: tables that are shown at once; the rest is behind a line to click on. All if None.
    """
    # Markdown, not HTML: `escaped` escapes what would break a table.
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(  # noqa: S701
        loader=PackageLoader("nw_eval.reporting"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["text"] = escaped
    drawn = [(table, markdown_table(table)) for table in tables]
    return environment.get_template("report.md.j2").render(
        title=_whose(run, verdict) if among_others else "",
        headline=headline(verdict, run),
        blind_spot=blind_spot(verdict, run),
        next_step=next_step(verdict, run),
        reasons=verdict.reasons,
        interrupted=run.interrupted,
        how_sure=how_sure(verdict, run),
        tables=drawn[:unfolded],
        folded=[] if unfolded is None else drawn[unfolded:],
    )


def _whose(run: RunInfo, verdict: Verdict) -> str:
    part = "" if run.shard is None else f", {run.shard}"
    return f"{verdict.verdict}: {run.suite.get('name', 'suite')}, {run.policy.folder_name}{part}"


def write_cause(cause: Cause, run: str, path: Path) -> None:
    """Write the page.

    Raises:
        StoreError: it cannot be written.
    """
    table = cause_table(cause)
    parts = [f"# {escaped(table.title)}: {escaped(run)}", markdown_table(table)]
    write_report(path, "\n\n".join([*parts, escaped(table.note)]) + "\n")


def write_report(path: Path, text: str) -> None:
    """Write a report, whole or not at all.

    Raises:
        StoreError: it cannot be written.
    """
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


_PADDED = 20


def markdown_table(table: Table) -> str:
    """Return a table in GitHub's Markdown, padded so that it reads as plain text too.

    Lines are padded to the names of columns up to `_PADDED` characters: a comment has little room.
    """
    cells = [[escaped(name) for name in table.columns]]
    cells += [
        [
            _code(cell) if name in table.code else escaped(cell)
            for name, cell in zip(table.columns, row, strict=True)
        ]
        for row in table.rows
    ]
    names, *lengths = [[len(cell) for cell in line] for line in cells]
    lengths.append([min(length, _PADDED) for length in names])
    widths = [max(3, *(line[index] for line in lengths)) for index in range(len(table.columns))]
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


_ACTS = re.compile(
    r"[@$]|#\d|gh-\d|://|mailto:|xmpp:|www\.|:(?:[+-]1|100|1234|[\w-]*[a-z][\w-]*):"
    r"|(?<![^\W_])[0-9a-f]{7,}(?![^\W_])",
    re.IGNORECASE,
)
"""What GitHub makes a mention, a reference, a link, a formula, an emoji or a commit's link of,
wherever it stands in a word. The action's `post.py` has a copy of these rules."""
_MARKS = re.compile(r"[\\`*\[\]<>|~&]|(?<![^\W_])_|_(?![^\W_])")
"""Signs of Markdown. Underscores within words are none in GitHub's, and names are full of them."""
_BEGINS = re.compile(r"(?:[-+=]+|#+|\d+[.)])(?= |$)")
"""What makes a heading or a list of a line that begins with it; a letter is put before its sign."""


def escaped(text: str) -> str:
    """Return words from anywhere (an error's text, a name) as one line of harmless Markdown.

    A word that would notify somebody or become a link is set as code, where it does neither; no
    backslash keeps GitHub from that.
    """
    line = " ".join(
        _code(word) if _ACTS.search(word) else _MARKS.sub(r"\\\g<0>", word)
        for word in clean(text, at_most=_LONGEST).split()
    )
    begins = _BEGINS.match(line)
    return line if begins is None else f"{line[: begins.end() - 1]}\\{line[begins.end() - 1 :]}"


def _code(text: str) -> str:
    # A backslash before a pipe would leave it to the renderer whether the cell ends there.
    line = re.sub(r"[`]|\\+(?=\|)", "'", clean(text, at_most=_LONGEST)).replace("|", "\\|")
    return f"`{line}`" if line else ""
