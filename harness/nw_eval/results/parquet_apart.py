"""A file of rows, read by a process of its own: see `tables`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from nw_eval.results.row import Row, from_dicts, to_dict
from nw_eval.results.stored import stored
from nw_eval.results.tables import answer, values_apart

_FIX = "restore the run's folder from a copy, or run again"


def read_rows_apart(path: Path) -> Sequence[Row]:
    """Return the rows of a Parquet file; as `parquet.read_rows`.

    Raises:
        StoreError: as there; or reading took too long, or ended its process.
    """
    return stored(rows_apart(path))


def rows_apart(path: Path) -> Iterator[list[Row]]:
    """Yield the rows of a Parquet file in portions; as `read_rows_apart`."""
    return map(from_dicts, values_apart(__name__, path, fix=_FIX))


def _rows(path: Path) -> Iterable[dict[str, Any]]:
    from nw_eval.results.parquet import read_groups

    for rows in read_groups(path):
        yield from map(to_dict, rows)


if __name__ == "__main__":
    answer(_rows)
