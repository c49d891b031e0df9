"""What a training measures on its way: as Parquet, as a picture, and for TensorBoard."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path

import pyarrow as pa

from nw_eval.errors import StoreError
from nw_eval.learn.program import tensorboard
from nw_eval.learn.program.picture import draw
from nw_eval.results.bounded import bounded_bytes
from nw_eval.results.tables.sealed import table_of, write_table

_MOST_ROWS = 5_000_000
_MOST_BYTES = 2**30
_STEP = "step"


class Curve:
    """Rows of numbers by step; names are `group/name`.

    The same training gives the same rows, so no clock is among them. Numbers that are not finite
    are left out.

    Args:
        folder: where `curve.parquet`, `curve.png` and `tensorboard/` are.
        upto: after a resume, the step of the state: rows beyond it are dropped, since they will be
            measured again. None = a new curve.
        counts: what steps are, for the picture.
        say: is told, once, where there will be no events for TensorBoard.

    Raises:
        StoreError: the rows cannot be read.
    """

    def __init__(
        self,
        folder: Path,
        *,
        upto: int | None = None,
        counts: str = "steps",
        say: Callable[[str], None] | None = None,
    ) -> None:
        self._folder = folder
        self._counts = counts
        self._rows: list[tuple[int, dict[str, float]]] = []
        if upto is not None:
            self._rows = [row for row in read_curve(self.path) if row[0] <= upto]
        self._events = tensorboard.events(folder / "tensorboard", first=upto or 0)
        self._unlogged = len(self._rows)
        if self._events is None and say is not None:
            say("no events for TensorBoard: `pip install nw-eval[tensorboard]` brings it")

    @property
    def path(self) -> Path:
        """The file of the rows."""
        return self._folder / "curve.parquet"

    @property
    def rows(self) -> tuple[tuple[int, Mapping[str, float]], ...]:
        """Steps and numbers so far."""
        return tuple(self._rows)

    def append(self, step: int, values: Mapping[str, float]) -> None:
        """Add what was measured at a step; steps only rise."""
        finite = {name: float(value) for name, value in values.items() if math.isfinite(value)}
        self._rows.append((step, finite))

    def flush(self) -> None:
        """Write everything that there is so far.

        Raises:
            StoreError: a file cannot be written.
        """
        if not self._rows:
            return
        names = sorted({name for _, values in self._rows for name in values})
        columns = {name: [values.get(name) for _, values in self._rows] for name in names}
        steps = pa.array([step for step, _ in self._rows], pa.int64())
        table = pa.table(
            {_STEP: steps, **{n: pa.array(column, pa.float64()) for n, column in columns.items()}}
        )
        write_table(self.path, table, {})
        draw(self._folder / "curve.png", steps.to_pylist(), columns, counts=self._counts)
        if self._events is not None:
            self._events.write(self._rows[self._unlogged :])
            self._unlogged = len(self._rows)


def read_curve(path: Path) -> list[tuple[int, dict[str, float]]]:
    """Return the rows of a curve's file; none where there is no file.

    Raises:
        StoreError: it is damaged, or no curve.
    """
    try:
        data = bounded_bytes(path, _MOST_BYTES)
        rows = table_of(data, most_rows=_MOST_ROWS, most_bytes=_MOST_BYTES).to_pylist()
        return [
            (int(row.pop(_STEP)), {name: float(v) for name, v in row.items() if v is not None})
            for row in rows
        ]
    except FileNotFoundError:
        return []
    except (pa.ArrowException, OSError, ValueError, LookupError, TypeError, MemoryError) as error:
        raise StoreError(f"{path} is damaged: {error}", fix="remove it; it begins anew") from None
