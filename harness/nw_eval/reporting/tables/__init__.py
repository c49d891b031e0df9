"""What a report says, as tables of text that Markdown and the console draw in their own ways."""

from __future__ import annotations

from collections.abc import Sequence
from operator import attrgetter
from pathlib import Path

from nw_eval.gate.cause import Cause
from nw_eval.gate.verdict import Verdict
from nw_eval.reporting.tables.cause import cause_table
from nw_eval.reporting.tables.run import provenance_table, throughput_table
from nw_eval.reporting.tables.scenes import scenes_table
from nw_eval.reporting.tables.success import (
    expectations_table,
    outcomes_table,
    perturbations_table,
    scores_by_scene_table,
    scores_table,
    tasks_table,
)
from nw_eval.reporting.tables.table import WORST, Table, judged
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
from nw_eval.results.provenance import RunInfo
from nw_eval.results.row import Row

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
        cause_table(cause),
        *(() if brief else (scores_by_scene_table(verdict),)),
        *(() if brief else (perturbations_table(ordered, verdict),)),
        outcomes_table(ordered),
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
        "perturbations": perturbations_table(rows, verdict),
        "outcomes": outcomes_table(rows),
        "contacts": contacts_table(rows, run),
        "failures": failures_table(rows, compared=verdict.against is not None),
        "errors": errors_table(rows),
        "left": left_table(rows, verdict),
        "coverage": coverage_table(rows, verdict),
        "throughput": throughput_table(rows, run),
        "provenance": provenance_table(run),
    }
