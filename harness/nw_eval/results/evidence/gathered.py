"""What is written of rows when their run has ended, gathered while they pass once."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from nw_eval.results.evidence.leaves import row_leaves
from nw_eval.results.row import COLUMNS, Result, RowTexts


class Gathered:
    """What digests.json, run.json and trials.parquet are made of.

    Attributes:
        leaves: the hash of each row, by trial.
        results: what `rows_digest` is the digest of.
        columns: all values, in the order of the rows.
    """

    def __init__(self) -> None:
        self.leaves: dict[str, str] = {}
        self.results: list[Result] = []
        self.columns: dict[str, list[Any]] = {name: [] for name in COLUMNS}

    def passing(self, portions: Iterable[RowTexts]) -> Iterator[RowTexts]:
        """Yield portions of rows as they are."""
        for texts in portions:
            self.leaves |= row_leaves(texts)
            self.results += texts.results()
            for name, values in texts.values.items():
                self.columns[name].extend(values)
            yield texts
