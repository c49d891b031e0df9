"""`nw-eval compare`: policies side by side."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING

import tyro

from nw_eval.cli.terminal.lines import aligned

if TYPE_CHECKING:
    from nw_eval.gate.side_by_side.result import PolicyComparison


@dataclass(frozen=True, kw_only=True)
class Compare:
    """Put the policies of runs or baselines side by side: ranks, scenes, where they part."""

    runs: tyro.conf.Positional[tuple[str, ...]]
    """Folders of runs, and baselines; each is compared with the first by waypoints."""
    out: Path | None = None
    """A Markdown page to write."""
    picture: Path | None = None
    """A PNG of all scenes and policies to write."""
    confidence: float = 0.95
    """Of each interval alone, and of all ranks together."""

    def __call__(self) -> int:
        from nw_eval import api

        found = api.compare(
            self.runs, out=self.out, picture=self.picture, confidence=self.confidence
        )
        print(comparison_text(found))
        for path in (self.out, self.picture):
            if path is not None:
                print(path)
        return 0


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
