"""A sweep's files: `sweep.md`, `sweep.png` and `sweep.parquet`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from nw_eval.files.cache import atomic_path
from nw_eval.gate.sweep import AxisCurve, Point
from nw_eval.reporting.markdown import escaped, markdown_table, write_report
from nw_eval.reporting.sweep.picture import draw_sweep
from nw_eval.reporting.sweep.words import cliff_words, parting_words, sweep_table


def write_sweep(axes: Sequence[Sequence[AxisCurve]], suite: str, out: Path) -> None:
    """Write a sweep's files.

    Args:
        axes: for each axis the curves of all policies.
        suite: its name.
        out: the folder, which is there.

    Raises:
        StoreError: a file cannot be written.
    """
    title = f"{suite}: success under perturbation"
    draw_sweep(axes, title, out / "sweep.png")
    parts = [f"# {escaped(title)}", "![Success by axis](sweep.png)"]
    for curves in axes:
        table = sweep_table(curves)
        parts += [f"## {table.title}"]
        parts += ["\n".join(f"* {escaped(line)}" for line in sweep_words(curves))]
        parts += [markdown_table(table)]
    parts += [escaped(sweep_table(axes[0]).note)]
    write_report(out / "sweep.md", "\n\n".join(parts) + "\n")
    _write_rows(axes, out / "sweep.parquet")


def sweep_words(curves: Sequence[AxisCurve]) -> list[str]:
    """Return what the curves of one axis say: cliffs, and where policies part from the first."""
    lines = [line for curve in curves for line in cliff_words(curve)]
    return lines + [parting_words(curves[0], other) for other in curves[1:]]


def _write_rows(axes: Sequence[Sequence[AxisCurve]], path: Path) -> None:
    """Write a row for each value and policy; `falls` is null where there are too few trials."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    schema = pa.schema(
        {
            "axis": pa.string(),
            "value": pa.float64(),
            "policy": pa.string(),
            "trials": pa.int64(),
            "errors": pa.int64(),
            "completed": pa.int64(),
            "success": pa.float64(),
            "low": pa.float64(),
            "high": pa.float64(),
            "falls": pa.bool_(),
            "trials_needed": pa.int64(),
        }
    )
    rows = [
        {
            "axis": curve.axis,
            "value": point.value,
            "policy": curve.policy,
            "trials": point.trials,
            "errors": point.errors,
            "completed": sum(done for done, _ in point.completed.values()),
            "success": point.mean,
            "low": point.interval.low,
            "high": point.interval.high,
            "falls": _falls(curve, point),
            "trials_needed": curve.needed,
        }
        for curves in axes
        for curve in curves
        for point in curve.points
    ]
    with atomic_path(path) as temporary:
        pq.write_table(pa.Table.from_pylist(rows, schema=schema), temporary)


def _falls(curve: AxisCurve, point: Point) -> bool | None:
    """Return whether a policy falls at a value; None where its trials are too few to tell."""
    if any(cliff.falls is point for cliff in curve.cliffs):
        return True
    return False if point is curve.reference or curve.could_fall(point) else None
