"""The table of what was reached in each task: all its scenes together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from nw_eval.gate.verdict import Verdict
from nw_eval.reporting.tables.success import bounds_of
from nw_eval.reporting.tables.table import (
    Bar,
    Table,
    bounds_header,
    judged,
    span,
    uncorrected,
)
from nw_eval.results.row import Row


def tasks_table(rows: Sequence[Row], verdict: Verdict) -> Table:
    """Return success in every task, its scenes weighted equally; scenes that do not count left out.

    Args:
        rows: in the order of their names.
        verdict: on them, with the drop in each scene where there is a baseline.
    """
    counted = {item.scene for item in verdict.per_scene if item.tier != "informational"}
    rows = [row for row in judged(rows, verdict) if row.scene in counted]
    tasks = sorted({row.task for row in rows if row.success is not None})
    groups = {task: _groups(rows, task) for task in tasks}
    # The mean of the only task is the run's, and has the bounds of the verdict.
    several = len(tasks) > 1
    header = bounds_header(1.0 - verdict.confidence, 1.0 - verdict.confidence)
    bounds = {
        task: bounds_of(found, verdict) if several else verdict.interval
        for task, found in groups.items()
    }
    means = {task: float(np.mean([each.mean() for each in groups[task]])) for task in tasks}
    if not several and verdict.success is not None:
        means = dict.fromkeys(tasks, verdict.success)
    against = verdict.against is not None
    return Table(
        title="Tasks",
        columns=(
            *("task", "scenes", "trials", "success"),
            *((header,) if several else ()),
            *(("baseline", "drop") if against else ()),
        ),
        rows=tuple(
            (
                task,
                str(len(_scenes(rows, task))),
                str(sum(len(each) for each in groups[task])),
                f"{means[task]:.3f}",
                *((span(bounds[task]),) if several else ()),
                *(_drop(verdict, _scenes(rows, task) if several else None) if against else ()),
            )
            for task in tasks
        ),
        numbers=frozenset({"scenes", "trials", "success", "baseline", "drop", header}),
        note=uncorrected("task", header) if several else "",
        bars=tuple(Bar(value=means[task], interval=bounds[task]) for task in tasks),
    )


def _scenes(rows: Sequence[Row], task: str) -> list[str]:
    return sorted({row.scene for row in rows if row.task == task})


def _groups(rows: Sequence[Row], task: str) -> list[NDArray[np.float64]]:
    """Return success of the trials of each scene of a task."""
    groups: dict[str, list[float]] = {scene: [] for scene in _scenes(rows, task)}
    for row in rows:
        if row.scene in groups and row.success is not None:
            groups[row.scene].append(row.success)
    return [np.array(group) for group in groups.values() if group]


def _drop(verdict: Verdict, scenes: Sequence[str] | None) -> tuple[str, str]:
    """Return what the baseline scores in some scenes, and how much less the candidate does.

    Args:
        verdict: with a comparison.
        scenes: that were met; None for all of the run, where it is the verdict's own drop.
    """
    if (found := verdict.against) is not None and scenes is None and found.drop is not None:
        return f"{found.baseline:.3f}", f"{found.drop:z.3f}"
    scenes = scenes or [item.scene for item in verdict.per_scene if item.tier != "informational"]
    items = [] if verdict.against is None else verdict.against.scenes
    items = [item for item in items if item.scene in scenes]
    drops = [item.drop for item in items if item.drop is not None]
    if not items:
        return "", ""
    known = [item.baseline for item in items if item.baseline is not None]
    baseline = f"{np.mean(known):.3f}" if len(known) == len(items) else ""
    return baseline, f"{np.mean(drops):z.3f}" if len(drops) == len(items) else ""
