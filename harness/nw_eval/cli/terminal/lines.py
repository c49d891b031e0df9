"""Lines that several verbs print."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

from nw_base.clean import clean
from nw_base.plural import in_words, plural

if TYPE_CHECKING:
    from nw_scenes.hub.reference import Fetched


def aligned(rows: Sequence[Sequence[str]], *, right: Collection[int] = ()) -> list[str]:
    """Return rows as lines, each column as wide as its widest cell.

    Args:
        rows: of equally many cells; a heading is one of them.
        right: the positions of the columns that end where the others begin: numbers.
    """
    if not rows:
        return []
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return [
        "  ".join(
            cell.rjust(width) if column in right else cell.ljust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


def fetched_lines(fetched: Fetched) -> str:
    """Return which revision something is, and where it lies."""
    amount = f"{plural(len(fetched.files), 'file')}, {in_words(fetched.bytes)}"
    return f"{clean(fetched)}: {amount}\n{fetched.folder}"
