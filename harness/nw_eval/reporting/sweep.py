"""A sweep: in words, as a table, and as the files `sweep.md`, `sweep.png` and `sweep.parquet`.

The words say where a policy breaks off, and where two part.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from nw_base.files.cache import atomic_path
from nw_base.plural import plural
from nw_eval.reporting.markdown import escaped, markdown_table, write_report
from nw_eval.reporting.pictures import axis_label, draw_sweep
from nw_eval.reporting.tables.table import Table, span
from nw_gate.sweep import AxisCurve, Cliff, Point, chance, needed_to_part


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
    """Return what the curves of one axis say: cliffs, and where policies diverge from the first."""
    lines = [line for curve in curves for line in cliff_words(curve)]
    return lines + [parting_words(curves[0], other) for other in curves[1:]]


def cliff_words(curve: AxisCurve) -> list[str]:
    """Return what a curve says, a line for each cliff, or one that says why there is none."""
    who, reference, values = curve.policy, curve.reference, [p.value for p in curve.points]
    if reference.mean is None:
        return [f"{who}: no result at {curve.axis} {reference.value:g}"]
    if reference.share == 0.0:
        where = f"{plural(reference.trials, 'trial')} at {curve.axis} {reference.value:g} completed"
        return [f"{who}: nothing to fall from: none of {where}"]
    if not curve.cliffs and curve.needed is not None:
        return [f"{who}: {too_few(curve.needed)} for a fall from {_counts(reference)} to none"]
    if not curve.cliffs:
        span = f"{curve.axis} {values[0]:g} to {values[-1]:g}"
        at = f"{reference.value:g} ({_share(reference)})"
        return [f"{who}: no cliff from {span}: nowhere beyond chance fewer complete than at {at}"]
    return [f"{who}: {_cliff(curve, cliff)}" for cliff in curve.cliffs]


def too_few(needed: int) -> str:
    """Return that a sweep has too few trials for its test, and how many `--trials` would do."""
    return (
        f"too few trials to tell; {needed} needed in each scene at each value (--trials {needed})"
    )


def _cliff(curve: AxisCurve, cliff: Cliff) -> str:
    reference, holds, falls = curve.reference, cliff.holds, cliff.falls
    fallen = (
        f"falls at {curve.axis} {falls.value:g}: {_share(falls)} against {_counts(reference)} at "
        f"{reference.value:g}"
    )
    if holds.share >= reference.share:
        return f"{fallen}; holds at {holds.value:g}"
    return f"{fallen}; whether it holds at {holds.value:g} ({_counts(holds)}), chance leaves open"


def _share(point: Point) -> str:
    return f"{_counts(point)} completed"


def _counts(point: Point) -> str:
    return f"{sum(done for done, _ in point.completed.values())} of {point.trials}"


def parting_words(one: AxisCurve, other: AxisCurve) -> str:
    """Return at which values two policies part beyond chance, Bonferroni over all of them."""
    theirs = {point.value: point for point in other.points}
    both = [(point, theirs[point.value]) for point in one.points if point.value in theirs]
    most = (1.0 - one.confidence) / max(1, len(both))
    parted = [(a, b) for a, b in both if chance(a, b) <= most]
    needed = needed_to_part(one, other)
    if not parted and needed is not None:
        both = f"{one.policy} and {other.policy}"
        return f"{both}: {too_few(needed)} for all of one and none of the other"
    if not parted:
        return f"{one.policy} and {other.policy}: at no value do they part beyond chance"
    text = ", ".join(f"{a.value:g} ({a.share:.2f} and {b.share:.2f})" for a, b in parted)
    return f"{one.policy} and {other.policy}: different shares complete at {one.axis} {text}"


def sweep_table(curves: Sequence[AxisCurve]) -> Table:
    """Return the table of one axis: a line for each value and policy."""
    first = curves[0]
    percent = f"{100 * first.confidence:.4g} % each alone"
    scores = tuple(
        dict.fromkeys(name for curve in curves for point in curve.points for name in point.scores)
    )
    lines = [
        (
            f"{point.value:g}",
            curve.policy,
            str(point.trials) + (f", {point.errors} errors" if point.errors else ""),
            "none" if point.mean is None else f"{point.mean:.3f}",
            "" if point.mean is None else span(point.interval),
            _counts(point),
            *(f"{point.scores[name]:.4g}" if name in point.scores else "" for name in scores),
        )
        for value in sorted({point.value for curve in curves for point in curve.points})
        for curve in curves
        for point in curve.points
        if point.value == value
    ]
    return Table(
        title=f"Success by {first.axis}",
        columns=(
            *(axis_label(first.axis), "policy", "trials", "success", percent, "completed"),
            *scores,
        ),
        rows=tuple(lines),
        numbers=frozenset({axis_label(first.axis), "success", *scores}),
        note="Success is the mean over scenes of the share of waypoints reached, its interval a "
        "Bayesian bootstrap. A cliff is the first value, outwards from the one nearest to neutral, "
        "at which fewer trials complete than there by Fisher's exact test with scenes as strata, "
        "Bonferroni over the values; where not even a fall to none would show, there are too few "
        "trials to tell. Two policies meet the same initial states; two values do not.",
    )


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
            "scores": pa.map_(pa.string(), pa.float64()),
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
            "scores": list(point.scores.items()),
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
