"""What a training measures on its way: as Parquet, as a picture, and for TensorBoard.

TensorBoard gets a file of events from each process that worked on a training. A new file begins
where the state stood; TensorBoard then hides what an earlier one has beyond.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pyarrow as pa

from nw_base.errors import StoreError
from nw_base.files.cache import atomic_path
from nw_base.files.inside import bounded_bytes
from nw_gate.results.sealed import table_of, write_table

_MOST_ROWS = 5_000_000
_MOST_BYTES = 2**30
_STEP = "step"

_PANELS_ACROSS = 3
_MOST_POINTS = 1000
"""Of a line: more are not seen, and take seconds to draw."""
_NAMED_LINES = 10
"""Lines that get a name in a panel's legend."""


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
        self._events = _event_file(folder / "tensorboard", first=upto or 0)
        self._unlogged = len(self._rows)
        if self._events is None and say is not None:
            say("no events for TensorBoard: `pip install 'nw-eval[tensorboard]'` brings it")

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
        raise StoreError(
            f"{path} is damaged: {error}", fix="remove it; a new one is started"
        ) from None


def draw(
    path: Path,
    steps: Sequence[int],
    columns: Mapping[str, Sequence[float | None]],
    *,
    counts: str = "steps",
) -> None:
    """Draw columns over steps.

    Args:
        path: of the PNG; appears whole or not at all.
        steps: (N,).
        columns: (N,) each, by `group/name`; None is a hole that a line goes over.
        counts: what steps are, for the axis.

    Raises:
        StoreError: the picture cannot be written.
    """
    from matplotlib.figure import Figure

    groups: dict[str, list[str]] = {}
    for name in columns:
        groups.setdefault(name.rpartition("/")[0], []).append(name)
    across = min(_PANELS_ACROSS, len(groups))
    down = math.ceil(len(groups) / across)
    width, height = 5.2 * across, 3.4 * down  # inches
    figure = Figure(figsize=(width, height))
    panels = figure.subplots(down, across, squeeze=False).flatten()
    # Margins for what stands around a panel; a layout that looks for them takes a second.
    figure.subplots_adjust(
        left=0.8 / width, right=1 - 0.2 / width, bottom=0.5 / height, top=1 - 0.4 / height,
        wspace=0.22, hspace=0.34,
    )  # fmt: skip
    unit, word = (1e6, f"million {counts}") if steps[-1] >= 1e6 else (1.0, counts)
    for axes, (group, names) in zip(panels, groups.items(), strict=False):
        for name in names:
            points = [
                (step / unit, value)
                for step, value in zip(steps, columns[name], strict=True)
                if value is not None
            ]
            points = points[:: math.ceil(len(points) / _MOST_POINTS)] if points else []
            axes.plot(
                [step for step, _ in points],
                [value for _, value in points],
                label=name.rpartition("/")[2],
                linewidth=1.2,
            )
        axes.set_title(group, parse_math=False)
        axes.set_xlabel(word)
        axes.grid(alpha=0.3)
        if 1 < len(names) <= _NAMED_LINES or not group:
            axes.legend(fontsize="small")
        elif len(names) == 1:
            axes.set_title(names[0], parse_math=False)
    for axes in panels[len(groups) :]:
        axes.remove()
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", dpi=100, metadata={"Software": None})


def _event_file(folder: Path, *, first: int) -> _EventFile | None:
    """Return where _event_file go; None where TensorBoard is not installed.

    Args:
        folder: of the files.
        first: step that this process goes on from.
    """
    return None if find_spec("tensorboard") is None else _EventFile(folder, first=first)


class _EventFile:
    """Events in one file, made with the first of them."""

    def __init__(self, folder: Path, *, first: int) -> None:
        number = len(list(folder.glob("_event_file.out.tfevents.*")))
        self._path = folder / f"_event_file.out.tfevents.{number:04d}.nw-eval"
        self._first = first
        self._has_begun = False

    def write(self, rows: Iterable[tuple[int, Mapping[str, float]]]) -> None:
        """Add rows.

        Raises:
            StoreError: the file cannot be written.
        """
        writer_of: Any = import_module("tensorboard.summary.writer.record_writer").RecordWriter
        pb: Any = import_module("tensorboard.compat.proto.event_pb2")
        scalar: Any = import_module("tensorboard.plugins.scalar.summary_v2").scalar_pb
        now = time.time()
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with self._path.open("ab") as file:
                writer = writer_of(file)
                if not self._has_begun:
                    writer.write(_bytes(pb.Event(wall_time=now, file_version="brain.Event:2")))
                    start = pb.SessionLog(status=pb.SessionLog.START)
                    begun = pb.Event(wall_time=now, step=self._first + 1, session_log=start)
                    writer.write(_bytes(begun))
                    self._has_begun = True
                for step, values in rows:
                    for name, value in values.items():
                        summary = scalar(name, value)
                        writer.write(_bytes(pb.Event(wall_time=now, step=step, summary=summary)))
                writer.flush()
        except OSError as error:
            raise StoreError(
                f"cannot write {self._path}: {error.strerror}", fix="free disk space"
            ) from error


def _bytes(event: Any) -> bytes:
    return event.SerializeToString(deterministic=True)
