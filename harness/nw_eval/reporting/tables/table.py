"""A table of a report, and how its cells are written."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import Self

from nw_base.clean import clean
from nw_gate.results.row import Row
from nw_gate.stats.interval import Interval
from nw_gate.verdict import Verdict

WORST = 8
"""Trials that a table of the worst ones names."""

_SHOWN, _TYPED = 500, 4000  # characters of a cell, and of one to type


@dataclass(frozen=True, kw_only=True)
class Bar:
    """What a page that draws shows beside a row, on an axis from 0 to 1."""

    value: float
    interval: Interval | None = None
    mark: float | None = None  # What to compare with: a baseline's value, a bar.
    change: bool = False  # Whether the way from the mark to the value is drawn: a gain, a loss.


@dataclass(frozen=True, kw_only=True)
class Table:
    """A titled table. `code` names the columns that hold something to type.

    Rows and run.json may be a third party's: what they say is cleaned here, for every page.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    numbers: frozenset[str] = frozenset()  # Columns to align on the right.
    code: frozenset[str] = frozenset()
    note: str = ""
    foot: str = ""  # A sentence right under the table, on a terminal too.
    bars: tuple[Bar | None, ...] = ()  # One for each row, or none at all.
    marked: str = ""  # What the marks of the bars are.

    def __post_init__(self) -> None:
        longest = [_TYPED if name in self.code else _SHOWN for name in self.columns]
        rows = tuple(
            tuple(clean(cell, at_most=most) for cell, most in zip(row, longest, strict=True))
            for row in self.rows
        )
        object.__setattr__(self, "rows", rows)

    def without_empty(self) -> Self:
        """Return the table without the columns in which no row has anything; the first one stays.

        Bars stay with their rows.
        """
        kept = [
            place
            for place in range(len(self.columns))
            if not place or any(row[place] for row in self.rows)
        ]
        shorter = copy(self)
        for name, value in (
            ("columns", tuple(self.columns[place] for place in kept)),
            ("rows", tuple(tuple(row[place] for place in kept) for row in self.rows)),
        ):
            object.__setattr__(shorter, name, value)
        return shorter

    def first(self, most: int, where: str) -> Self:
        """Return the table with its first rows only; its note says how many more are elsewhere.

        Args:
            most: rows that it keeps.
            where: the others are, such as `the artifact`.
        """
        if len(self.rows) <= most:
            return self
        shorter = copy(self)  # Not made anew: what is cleaned is not to be cut again.
        note = f"{len(self.rows) - most} more in {where}. {self.note}"
        object.__setattr__(shorter, "rows", self.rows[:most])
        object.__setattr__(shorter, "note", note.strip())
        return shorter


def judged(rows: Sequence[Row], verdict: Verdict) -> list[Row]:
    """Return the rows that a verdict speaks of: but for trials that left the captured volume."""
    return [row for row in rows if row.trial_id not in verdict.left]


def bounds_header(low: float, high: float) -> str:
    """Return the header of a column of intervals; `uncorrected` says the rest, in the table's note.

    Args:
        low: probability with which the low end errs, one-sided.
        high: the same of the high end.
    """
    return f"{100 * (1 - low):.4g} % lower, {100 * (1 - high):.4g} % upper"


def uncorrected(noun: str, header: str) -> str:
    """Return a sentence on intervals that each speak of one line of a table alone.

    Args:
        noun: what a line is of, such as `scene`.
        header: of their column.
    """
    return f"Per-{noun} interval ({header}), not corrected for the number of {noun}s."


def span(interval: Interval) -> str:
    """Return an interval as a cell."""
    return f"{interval.low:z.2f} to {interval.high:z.2f}"


def mean(values: Sequence[float | None]) -> str:
    """Return the mean of the values that are known; empty without any."""
    known = [value for value in values if value is not None]
    return f"{sum(known) / len(known):.3f}" if known else ""


def share(value: float | None) -> str:
    """Return a share as a cell; empty where there is none."""
    return "" if value is None else f"{value:.2f}"


def more(total: int, most: int = WORST) -> str:
    """Return a sentence on trials that a table does not name; empty where it names all."""
    return f"{total - most} more are in trials.parquet. " if total > most else ""
