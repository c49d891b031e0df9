"""The table of what was reached in each task: all its scenes together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nw_eval.gate.verdict import Verdict
from nw_eval.reporting.tables.table import Bar, Table, judged, span
from nw_eval.results.row import Row
from nw_eval.stats import Estimate, mean_of_scenes


def tasks_table(rows: Sequence[Row], verdict: Verdict) -> Table:
    """Return success in every task, its scenes weighted equally; scenes that do not count left out.

    Args:
        rows: in the order of their names.
        verdict: on them, with the drop in each scene where there is a baseline.
    """
    counted = {item.scene for item in verdict.per_scene if item.tier != "informational"}
    rows = [row for row in judged(rows, verdict) if row.scene in counted]
    tasks = sorted({row.task for row in rows if row.success is not None})
    found = {task: _estimate(rows, task, verdict.confidence) for task in tasks}
    against = verdict.against is not None
    return Table(
        title="Tasks",
        columns=(
            *("task", "scenes", "trials", "success"),
            f"{100 * verdict.confidence:.4g} % each alone",
            *(("baseline", "drop") if against else ()),
        ),
        rows=tuple(
            (
                task,
                str(len(_scenes(rows, task))),
                str(each.n),
                f"{each.mean:.3f}",
                span(each.interval),
                *(_drop(verdict, _scenes(rows, task)) if against else ()),
            )
            for task, each in found.items()
        ),
        numbers=frozenset({"scenes", "trials", "success", "baseline", "drop"}),
        bars=tuple(Bar(value=each.mean, interval=each.interval) for each in found.values()),
    )


def _scenes(rows: Sequence[Row], task: str) -> list[str]:
    return sorted({row.scene for row in rows if row.task == task})


def _estimate(rows: Sequence[Row], task: str, confidence: float) -> Estimate:
    """Return mean success in a task, of fresh starts in its scenes."""
    groups: dict[str, list[float]] = {scene: [] for scene in _scenes(rows, task)}
    for row in rows:
        if row.scene in groups and row.success is not None:
            groups[row.scene].append(row.success)
    return mean_of_scenes([np.array(group) for group in groups.values()], confidence)


def _drop(verdict: Verdict, scenes: Sequence[str]) -> tuple[str, str]:
    """Return what the baseline scores in some scenes, and how much less the candidate does."""
    items = [] if verdict.against is None else verdict.against.scenes
    items = [item for item in items if item.scene in scenes]
    drops = [item.drop for item in items if item.drop is not None]
    if not items:
        return "", ""
    baseline = f"{np.mean([item.baseline for item in items]):.3f}"
    return baseline, f"{np.mean(drops):z.3f}" if len(drops) == len(items) else ""
