"""`nw-eval compare`: policies side by side."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING

from nw_eval.cli.terminal.lines import aligned
from nw_eval.cli.verbs.printed import Printed
from nw_eval.cli.verbs.verb import Verb, verb_of

if TYPE_CHECKING:
    from nw_gate.side_by_side import PolicyComparison


@verb_of("compare")
class Compare(Printed, Verb):
    """Compare runs or baselines: ranks, scenes, and where results differ."""

    out: Path | None
    picture: Path | None

    def show(self, found: PolicyComparison) -> str:
        written = [str(path) for path in (self.out, self.picture) if path is not None]
        return "\n".join([comparison_text(found), *written])


_WIDTH = 100
_MOST_WIDE = 120  # characters of a table


def comparison_text(found: PolicyComparison) -> str:
    """Return the tables of a comparison, each with its title and its note."""
    from nw_eval.reporting.side_by_side import comparison_tables

    parts: list[str] = []
    for table in comparison_tables(found):
        right = [place for place, name in enumerate(table.columns) if name in table.numbers]
        lines = _folded([table.columns, *table.rows], right=right)
        note = [fill(table.note, _WIDTH)] if table.note else []
        parts.append("\n".join([table.title, "", *lines, *([""] if note else []), *note]))
    return "\n\n".join(parts)


def _folded(rows: Sequence[Sequence[str]], *, right: Collection[int]) -> list[str]:
    """Return the lines of a table; one that is too wide goes on beneath, with its first column."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    blocks: list[list[int]] = [[]]
    for column in range(1, len(widths)):
        shown = [widths[0], *(widths[each] for each in blocks[-1]), widths[column]]
        if blocks[-1] and sum(shown) + 2 * (len(shown) - 1) > _MOST_WIDE:
            blocks.append([])
        blocks[-1].append(column)
    lines: list[str] = []
    for block in blocks:
        columns = [0, *block]
        ends = [place for place, column in enumerate(columns) if column in right]
        lines += [""] if lines else []
        lines += aligned([[row[each] for each in columns] for row in rows], right=ends)
    return lines
