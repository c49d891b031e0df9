"""From trials to numbers: mean success with its interval, alone and on the same starts.

The numbers of a study's figure are written as Parquet for programs and as Markdown for people.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from nw_base.plural import plural
from nw_eval.reporting.markdown import escaped, markdown_table, write_report
from nw_gate.results.sealed import write_table
from nw_gate.stats.bootstrap import mean_of_scenes
from nw_gate.stats.interval import Estimate, Interval

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from nw_eval.reporting.tables.table import Table

_SCHEMA = pa.schema(
    [
        ("student", pa.string()),
        ("round", pa.int64()),
        ("group", pa.string()),
        ("against", pa.string()),
        ("trials", pa.int64()),
        ("errors", pa.int64()),
        ("success", pa.float64()),
        ("low", pa.float64()),
        ("high", pa.float64()),
    ]
)


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What one trial of a student came to."""

    student: str
    round: int
    scene: str
    trial: str
    """Name of the start: the same for all students."""
    success: float | None
    """Share of waypoints reached; None for an error, which says nothing about the student."""


@dataclass(frozen=True, kw_only=True)
class Score:
    """A number of a figure."""

    student: str
    round: int
    group: str
    """The scenes that it is of."""
    estimate: Estimate | None
    """None where no trial came to a result."""
    errors: int
    """Trials that came to none."""
    against: str = ""
    """The student whose success on the same starts was taken off; empty for none."""


def score(outcomes: Sequence[Outcome], *, student: str, number: int, group: str) -> Score:
    """Return a student's mean success, scenes weighted equally.

    Args:
        outcomes: of this student after this round, in these scenes.
        student: whose they are.
        number: of the round.
        group: what the scenes are called.
    """
    values = _by_scene((each.scene, each.success) for each in outcomes if each.success is not None)
    return Score(
        student=student,
        round=number,
        group=group,
        estimate=mean_of_scenes(values) if values else None,
        errors=sum(each.success is None for each in outcomes),
    )


def difference(
    outcomes: Sequence[Outcome], others: Sequence[Outcome], *, student: str, group: str
) -> Score:
    """Return a student's mean success less another's, on the starts that both have a result from.

    A start's difference lies within [-1, 1]: its place there, from 0 to 1, is what
    `mean_of_scenes` is of, which so keeps scenes equal and starts paired.

    Args:
        outcomes: of the student.
        others: of the one that it is compared with.
        student: whose the first are.
        group: what the scenes are called.
    """
    success = {each.trial: each.success for each in others}
    pairs = [(each, each.success, success.get(each.trial)) for each in outcomes]
    known = [
        (each.scene, (1.0 + mine - theirs) / 2.0)
        for each, mine, theirs in pairs
        if mine is not None and theirs is not None
    ]
    estimate = mean_of_scenes(_by_scene(known)) if known else None
    return Score(
        student=student,
        round=max((each.round for each in outcomes), default=0),
        group=group,
        estimate=None if estimate is None else _unfolded(estimate),
        errors=len(pairs) - len(known),
        against=others[0].student if others else "",
    )


def _unfolded(estimate: Estimate) -> Estimate:
    """Return an estimate of places between 0 and 1 as one of differences."""
    low, high = (2.0 * end - 1.0 for end in estimate.interval)
    return Estimate(
        mean=2.0 * estimate.mean - 1.0,
        interval=Interval(low, high),
        n=estimate.n,
        confidence=estimate.confidence,
    )


def _by_scene(values: Iterable[tuple[str, float]]) -> list[np.ndarray]:
    groups: dict[str, list[float]] = {}
    for scene, value in values:
        groups.setdefault(scene, []).append(value)
    return [np.array(groups[scene]) for scene in sorted(groups)]


def write_scores(path: Path, scores: Sequence[Score]) -> None:
    """Write scores as Parquet, a row each; `success`, `low` and `high` are null without results.

    With `against` they are of differences on the same starts.

    Raises:
        StoreError: the file cannot be written.
    """
    rows = [
        {
            "student": each.student,
            "round": each.round,
            "group": each.group,
            "against": each.against,
            "trials": 0 if each.estimate is None else each.estimate.n,
            "errors": each.errors,
            "success": None if each.estimate is None else each.estimate.mean,
            "low": None if each.estimate is None else each.estimate.interval.low,
            "high": None if each.estimate is None else each.estimate.interval.high,
        }
        for each in scores
    ]
    write_table(path, pa.Table.from_pylist(rows, schema=_SCHEMA), {})


def write_page(path: Path, tables: Sequence[Table]) -> None:
    """Write tables as a page of Markdown, the first one's title on top.

    Raises:
        StoreError: the file cannot be written.
    """
    parts: list[str] = []
    for level, table in enumerate(tables):
        parts += [f"{'##' if level else '#'} {escaped(table.title)}", markdown_table(table)]
        parts += [escaped(table.note)] if table.note else []
    write_report(path, "\n\n".join(parts) + "\n")


def cell(score: Score | None) -> str:
    """Return a score as a cell: its value, its interval, its trials."""
    if score is None or score.estimate is None:
        return "none" if score is not None and score.errors else ""
    estimate = score.estimate
    sign = "+z" if score.against else ""
    low, high = estimate.interval
    text = f"{estimate.mean:{sign}.2f} ({low:{sign}.2f} to {high:{sign}.2f}), {estimate.n}"
    return f"{text}, {plural(score.errors, 'error')}" if score.errors else text
