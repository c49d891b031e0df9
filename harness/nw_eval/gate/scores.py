"""Rows to scores, scene by scene."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import StoreError
from nw_eval.gate.validity import too_many
from nw_eval.gate.verdict import SceneScore
from nw_eval.results.row import Row
from nw_eval.stats import Interval, mean_of_scenes
from nw_eval.suite.model import Gate

_DRAWS = 2000
"""For the interval of one scene, of which there may be hundreds: shown with two digits."""


def successes(
    rows: Sequence[Row], left: Collection[str] = (), *, counted: float | None = None
) -> NDArray[np.float64]:
    """Return the success rates of the trials that have a result, shape (n,).

    Args:
        rows: in any order.
        left: trials that left the captured volume.
        counted: as which success these count; they are left out if None.
    """
    values = [
        counted if row.trial_id in left else row.success for row in rows if row.success is not None
    ]
    return np.array([value for value in values if value is not None], dtype=np.float64)


def by_scene(rows: Sequence[Row], planned: Mapping[str, int]) -> dict[str, list[Row]]:
    """Return the rows of every scene that was planned or met, scenes in alphabetical order.

    Raises:
        StoreError: a trial appears twice, which would count it twice.
    """
    groups: dict[str, list[Row]] = {scene: [] for scene in sorted({*planned, *_scenes(rows)})}
    seen: set[str] = set()
    for row in rows:
        if row.trial_id in seen:
            raise StoreError(
                f"trial {row.trial_id} appears twice among the rows", fix="keep one row of a trial"
            )
        seen.add(row.trial_id)
        groups[row.scene].append(row)
    return groups


def score(
    scene: str, rows: Sequence[Row], planned: int, gate: Gate, left: Collection[str] = ()
) -> SceneScore:
    """Return the score of one scene from its rows, but for trials that left the captured volume."""
    outside = sum(row.trial_id in left for row in rows)
    rows = [row for row in rows if row.trial_id not in left]
    values = successes(rows)
    completed = sum(row.completed for row in rows)
    estimate = mean_of_scenes([values], gate.confidence, draws=_DRAWS) if values.size else None
    bar = gate.success_rate
    return SceneScore(
        scene=scene,
        tier=gate.tier(scene),
        planned=planned,
        n=values.size,
        errors=sum(row.status == "error" for row in rows),
        completed=completed,
        mean=estimate.mean if estimate else None,
        interval=estimate.interval if estimate else Interval(0.0, 1.0),
        weak=bar is not None and estimate is not None and estimate.interval.high < bar,
        outside=outside,
        unseen=too_many(outside, outside + values.size, gate),
    )


def _scenes(rows: Sequence[Row]) -> set[str]:
    return {row.scene for row in rows}
