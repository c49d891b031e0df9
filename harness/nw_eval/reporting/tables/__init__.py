"""What a report says, as tables of text that Markdown and the console draw in their own ways."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from operator import attrgetter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nw_base.plural import plural
from nw_base.words import OUTCOMES
from nw_eval.reporting.tables.cause import cause_table
from nw_eval.reporting.tables.run import provenance_table, throughput_table
from nw_eval.reporting.tables.scenes import scenes_table
from nw_eval.reporting.tables.table import (
    WORST,
    Bar,
    Table,
    bounds_header,
    judged,
    mean,
    span,
    uncorrected,
)
from nw_eval.reporting.tables.trials import (
    NO_RIVALS,
    Rivals,
    contacts_table,
    coverage_table,
    errors_table,
    failures_table,
    left_table,
    worst_table,
)
from nw_gate.cause import Cause
from nw_gate.results.provenance import RunInfo
from nw_gate.results.row import Row, task_shown
from nw_gate.scores.own import EXPECT
from nw_gate.stats.betting import lower_bound, upper_bound
from nw_gate.stats.interval import Interval
from nw_gate.verdict import LimitFinding, ScoreFinding, Verdict

__all__ = ["NO_RIVALS", "Rivals", "Table", "all_tables", "named_tables"]


def all_tables(
    run: RunInfo,
    rows: Sequence[Row],
    verdict: Verdict,
    folder: Path,
    *,
    brief: bool = False,
    cause: Cause | None = None,
    rivals: Rivals = NO_RIVALS,
) -> tuple[Table, ...]:
    """Return every table that has rows, in the order of a report.

    Args:
        run: the run's provenance.
        rows: one for each trial, in any order.
        verdict: what the gate says of them.
        folder: the run's folder as a reader would type it; replay commands start with it.
        brief: for a terminal: fewer of the worst trials, no perturbations and no provenance.
        cause: what its drop is due to, where that was asked.
        rivals: trials of the baseline's policy from the same starts, by the run's trials.
    """
    ordered = sorted(rows, key=attrgetter("trial_id"))
    worst = worst_table(judged(ordered, verdict), folder, most=3 if brief else WORST, rivals=rivals)
    tables = (
        *(() if brief else (worst,)),  # On a terminal the last lines are read first.
        scenes_table(verdict, ordered, brief=brief),
        scores_table(verdict),
        expectations_table(verdict),
        gated_limits_table(verdict),
        cause_table(cause),
        *(() if brief else (scores_by_scene_table(verdict),)),
        *(() if brief else (perturbations_table(ordered, verdict),)),
        outcomes_table(ordered, verdict),
        contacts_table(ordered, run),
        failures_table(ordered, compared=verdict.against is not None),
        errors_table(ordered),
        *((worst,) if brief else ()),
        throughput_table(ordered, run),
        left_table(ordered, verdict),
        coverage_table(ordered, verdict),
        *(() if brief else (provenance_table(run),)),
    )
    return tuple(table for table in tables if table.rows)


def named_tables(
    run: RunInfo, rows: Sequence[Row], verdict: Verdict, cause: Cause | None = None
) -> dict[str, Table]:
    """Return every table, with rows or without, by a name; for a page that puts each in its place.

    Args:
        run: the run's provenance.
        rows: one for each trial, in the order of their names.
        verdict: what the gate says of them.
        cause: what its drop is due to, where that was asked.
    """
    return {
        "cause": cause_table(cause),
        "tasks": tasks_table(rows, verdict),
        "scenes": scenes_table(verdict, rows),
        "scores": scores_table(verdict),
        "expectations": expectations_table(verdict),
        "scores_by_scene": scores_by_scene_table(verdict),
        "limits": gated_limits_table(verdict),
        "perturbations": perturbations_table(rows, verdict),
        "outcomes": outcomes_table(rows, verdict),
        "contacts": contacts_table(rows, run),
        "failures": failures_table(rows, compared=verdict.against is not None),
        "errors": errors_table(rows),
        "left": left_table(rows, verdict),
        "coverage": coverage_table(rows, verdict),
        "throughput": throughput_table(rows, run),
        "provenance": provenance_table(run),
    }


def expectations_table(verdict: Verdict) -> Table:
    """Return what the suite expects of each trial, and how many kept it."""
    found = [item for item in verdict.scores if item.spec.name.startswith(EXPECT)]
    gated = any(item.word is not None for item in found)
    return Table(
        title="Expectations",
        columns=("name", "share of trials in which", "kept", *(("verdict",) if gated else ())),
        rows=tuple(
            (
                item.spec.name.removeprefix(EXPECT),
                item.spec.meaning.removeprefix("share of trials in which "),
                f"{item.kept} of {item.trials}",
                *((item.word or "-",) if gated else ()),
            )
            for item in found
        ),
        note="Their means and bounds are in the table of scores; `gate.scores` judges them as "
        f"`{EXPECT}NAME`.",
    )


_MOST_COLUMNS = 6


def scores_by_scene_table(verdict: Verdict) -> Table:
    """Return the mean of each score in each scene, the scores that are gated first."""
    found = sorted(verdict.scores, key=lambda item: item.word is None)[:_MOST_COLUMNS]
    scenes = sorted({scene for item in found for scene in item.per_scene})
    names = tuple(item.spec.name for item in found)
    left = len(verdict.scores) - len(found)
    return Table(
        title="Scores by scene",
        columns=("scene", *names),
        rows=tuple(
            (scene, *(_number(item.per_scene.get(scene)) for item in found)) for scene in scenes
        )
        if len(scenes) > 1
        else (),
        numbers=frozenset(names),
        note="Means of trials, in the score's unit."
        + (f" Rows have {plural(left, 'score')} more." if left else ""),
    )


def scores_table(verdict: Verdict) -> Table:
    """Return what was measured beside success, a line for each score, in its unit."""
    found = verdict.scores
    compared = any(item.baseline is not None for item in found)
    gated = any(item.word is not None for item in found)
    undefined = any(item.undefined for item in found)
    bounds = f"{100 * verdict.confidence:.4g} % bounds"
    meanings = "; ".join(f"{item.spec.name}: {item.spec.meaning}" for item in found)
    return Table(
        title="Scores",
        columns=(
            "score",
            "unit",
            "better",
            "trials",
            *(("undefined",) if undefined else ()),
            "mean",
            bounds,
            *(("baseline", "change") if compared else ()),
            *(("verdict",) if gated else ()),
        ),
        rows=tuple(
            (
                item.spec.name,
                item.spec.unit or "-",
                item.spec.better,
                str(item.trials),
                *((str(item.undefined),) if undefined else ()),
                _number(item.mean),
                f"{item.interval.low:.4g} to {item.interval.high:.4g}",
                *((_number(item.baseline), _change(item)) if compared else ()),
                *((item.word or "-",) if gated else ()),
            )
            for item in found
        ),
        numbers=frozenset({"trials", "undefined", "mean", "baseline", "change"}),
        note=f"Means weigh scenes equally. A trial in which a score is undefined counts as its "
        f"definition requires. {meanings}.",
    )


def gated_limits_table(verdict: Verdict) -> Table:
    """Return what the gate's ladders show: up to which rung the policy gets, in their units."""
    found = verdict.limits
    compared = any(item.baseline is not None for item in found)
    return Table(
        title="Limits",
        columns=(
            *("ladder", "cleared up to", "not cleared at"),
            *(("baseline",) if compared else ()),
            *("asked", "trials", "verdict"),
        ),
        rows=tuple(
            (
                item.ladder,
                *(("", "") if item.candidate is None else item.candidate.bound_texts),
                *(
                    (("" if item.baseline is None else item.baseline.range_text),)
                    if compared
                    else ()
                ),
                _asked(item),
                "0" if item.candidate is None else str(len(item.candidate.trials)),
                item.word or "-",
            )
            for item in found
        ),
        numbers=frozenset({"trials"}),
        note=f"A rung is cleared if the policy completes at least the gate's share of its trials "
        f"there; bounds of the policy hold with {100 * verdict.confidence:.4g} % confidence, each "
        "alone. Where a bound is `none`, the trials show none: a gate looks for what it asks only.",
    )


def _asked(item: LimitFinding) -> str:
    """Return what the gate asks of a limit, in the unit of its ladder."""
    says = str if item.candidate is None else item.candidate.ladder.says
    least = [] if item.at_least is None else [f"at least {says(item.at_least)}"]
    if item.at_least is not None and item.candidate and not item.candidate.ladder.rises:
        least = [f"at most {says(item.at_least)}"]
    most = [] if item.max_drop is None else [f"max_drop {says(item.max_drop)}"]
    return ", ".join([*least, *most])


def _number(value: float | None) -> str:
    return "none" if value is None else f"{value:.4g}"


def _change(item: ScoreFinding) -> str:
    if item.drop is None:
        return ""
    change = item.drop if item.spec.better == "lower" else -item.drop
    return f"{change:+.4g}"


def tasks_table(rows: Sequence[Row], verdict: Verdict) -> Table:
    """Return success in every task, its scenes weighted equally; scenes that do not count left out.

    Args:
        rows: in the order of their names.
        verdict: on them, with the drop in each scene where there is a baseline.
    """
    counted = {item.scene for item in verdict.per_scene if item.tier != "informational"}
    rows = [row for row in judged(rows, verdict) if row.scene in counted]
    tasks = sorted({task_shown(row.scene, row.task) for row in rows if row.success is not None})
    groups = {task: _groups_of(rows, task) for task in tasks}
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
                str(len(_scenes_of(rows, task))),
                str(sum(len(each) for each in groups[task])),
                f"{means[task]:.3f}",
                *((span(bounds[task]),) if several else ()),
                *(
                    _drop_in(verdict, _scenes_of(rows, task) if several else None)
                    if against
                    else ()
                ),
            )
            for task in tasks
        ),
        numbers=frozenset({"scenes", "trials", "success", "baseline", "drop", header}),
        note=uncorrected("task", header) if several else "",
        bars=tuple(Bar(value=means[task], interval=bounds[task]) for task in tasks),
    )


def _scenes_of(rows: Sequence[Row], task: str) -> list[str]:
    return sorted({row.scene for row in rows if task_shown(row.scene, row.task) == task})


def _groups_of(rows: Sequence[Row], task: str) -> list[NDArray[np.float64]]:
    """Return success of the trials of each scene of a task."""
    groups: dict[str, list[float]] = {scene: [] for scene in _scenes_of(rows, task)}
    for row in rows:
        if row.scene in groups and row.success is not None:
            groups[row.scene].append(row.success)
    return [np.array(group) for group in groups.values() if group]


def _drop_in(verdict: Verdict, scenes: Sequence[str] | None) -> tuple[str, str]:
    """Return what the baseline scores in some scenes, and how much less the candidate does.

    Args:
        verdict: with a comparison.
        scenes: that were met; None for all of the run, where it is the verdict's own drop.
    """
    if (found := verdict.against) is not None and scenes is None and found.drop is not None:
        met = found.baseline if found.baseline_met is None else found.baseline_met
        return f"{met:.3f}", f"{found.drop:z.3f}"
    scenes = scenes or [item.scene for item in verdict.per_scene if item.tier != "informational"]
    items = [] if verdict.against is None else verdict.against.scenes
    items = [item for item in items if item.scene in scenes]
    drops = [item.drop for item in items if item.drop is not None]
    if not items:
        return "", ""
    known = [item.baseline for item in items if item.baseline is not None]
    baseline = f"{np.mean(known):.3f}" if len(known) == len(items) else ""
    return baseline, f"{np.mean(drops):z.3f}" if len(drops) == len(items) else ""


def outcomes_table(rows: Sequence[Row], verdict: Verdict) -> Table:
    """Return how the trials ended that are this run's own."""
    again = None if verdict.against is None else verdict.against.again
    of = f"Of the {plural(len(rows), 'trial')} of this run; the other results are the baseline's."
    ended: defaultdict[str, list[Row]] = defaultdict(list)
    for row in rows:
        ended[row.outcome].append(row)
    order = sorted(ended, key=lambda name: (name not in OUTCOMES, -len(ended[name]), name))
    return Table(
        title="Outcomes",
        columns=("outcome", "trials", "share", "mean success", "most often by"),
        rows=tuple(
            (
                name if name in OUTCOMES else f"{name} (error)",
                str(len(ended[name])),
                f"{100 * len(ended[name]) / len(rows):.0f} %",
                mean([row.success for row in ended[name]]),
                Counter(row.end_reason for row in ended[name]).most_common(1)[0][0],
            )
            for name in order
        ),
        numbers=frozenset({"trials", "share", "mean success"}),
        foot=of if again is not None and again.taken_over else "",
    )


def perturbations_table(rows: Sequence[Row], verdict: Verdict) -> Table:
    """Return success in every cell of the perturbation grid, over all scenes; none without one."""
    header = bounds_header(1.0 - verdict.confidence, 1.0 - verdict.confidence)
    cells = sorted({row.perturbation for row in rows} - {()})
    lines: list[tuple[str, ...]] = []
    for cell in cells:
        scenes: dict[str, list[float]] = {}
        for row in judged(rows, verdict):
            if row.perturbation == cell and row.success is not None:
                scenes.setdefault(row.scene, []).append(row.success)
        name = ", ".join(f"{axis} {value:g}" for axis, value in cell)
        if scenes:
            groups = [np.array(values) for _, values in sorted(scenes.items())]
            cells_mean = float(np.mean([group.mean() for group in groups]))
            count = str(sum(len(group) for group in groups))
            lines.append((name, count, f"{cells_mean:.3f}", *_bounds(groups, verdict, cells)))
        else:
            lines.append((name, "0", "none", *([""] if len(cells) > 1 else [])))
    return Table(
        title="Success by perturbation",
        columns=(
            *("perturbation", "trials", "success"),
            *((header,) if len(cells) > 1 else ()),
        ),
        rows=tuple(lines),
        numbers=frozenset({"trials", "success", header}),
        note=uncorrected("cell", header) if len(cells) > 1 else "",
    )


def _bounds(
    groups: Sequence[NDArray[np.float64]], verdict: Verdict, cells: Sequence[object]
) -> list[str]:
    """Return the bounds of a cell's mean; none of the only cell, whose mean is the run's."""
    return [span(bounds_of(groups, verdict))] if len(cells) > 1 else []


def bounds_of(groups: Sequence[NDArray[np.float64]], verdict: Verdict) -> Interval:
    """Return the bounds of the mean of some scenes, as those that the verdict rests on are made.

    Args:
        groups: success of the trials of each scene.
        verdict: whose confidence each bound has, one-sided.
    """
    level = verdict.confidence
    return Interval(lower_bound(groups, level), upper_bound(groups, level))
