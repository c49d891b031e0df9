"""Rows to rounds: what the candidate scored, beside the baseline, in the order of the draw."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import nan

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import StoreError
from nw_eval.gate.baseline.draw import draw_starts
from nw_eval.results.bank import Panel, Stratum, score
from nw_eval.results.provenance import RunInfo
from nw_eval.results.row import Row
from nw_eval.words import Arm

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Rounds:
    """Whole rounds of a run: each has one trial of every stratum."""

    rows: Mapping[Stratum, tuple[Row | None, ...]]
    """R rows of every stratum; None is a trial of a round that is missing."""
    starts: Mapping[Stratum, tuple[int, ...]]
    """Index of the start in each of the R rounds."""
    count: int
    """R."""
    left_out: int
    """Rows beyond the last whole round."""
    left: frozenset[str] = frozenset()
    """Trials that left the captured volume (`gate.validity`): nothing is known of their starts."""

    def first(self, count: int) -> Rounds:
        """Return the first rounds alone."""
        rows = {stratum: found[:count] for stratum, found in self.rows.items()}
        starts = {stratum: drawn[:count] for stratum, drawn in self.starts.items()}
        return replace(self, rows=rows, starts=starts, count=count)

    def scores(self, strata: Sequence[Stratum]) -> Floats:
        """Return c, shape (R, S): NaN where a trial has no result, or left the captured volume."""
        columns = [[self._score(row) for row in self.rows[stratum]] for stratum in strata]
        return np.array(columns, dtype=np.float64).reshape(len(strata), self.count).T

    def known(self, strata: Sequence[Stratum], panel: Panel) -> Floats:
        """Return b of the same starts, shape (R, S)."""
        columns = [
            scores_of(panel, stratum)[np.array(self.starts[stratum], dtype=np.intp)]
            for stratum in strata
        ]
        return np.array(columns).reshape(len(strata), self.count).T

    def counts(self, row: Row) -> bool:
        """Return whether a trial has a result, and one that counts."""
        return row.status == "ok" and row.trial_id not in self.left

    def _score(self, row: Row | None) -> float:
        counted = None if row is None or row.trial_id in self.left else score(row)
        return nan if counted is None else counted


def scores_of(panel: Panel, stratum: Stratum) -> Floats:
    """Return b of all starts of a stratum, shape (M,)."""
    return np.array([score(start) for start in panel.by_stratum[stratum]], dtype=np.float64)


def budget_of(run: RunInfo) -> int:
    """Return the most rounds that a run was to have: trials of each scene in each of its cells."""
    return int(run.suite["trials"])


def whole_rounds(
    rows: Iterable[Row],
    run: RunInfo,
    strata: Sequence[Stratum],
    arm: Arm = "candidate",
    *,
    left: frozenset[str] = frozenset(),
) -> Rounds:
    """Return the rounds up to the last one of which every trial has a row.

    A round's trial is the next start of its stratum in the order of the draw (`draw_starts`): of
    all starts of the bank where the run drew them so, else of those that it planned anyhow. Starts
    of a fresh panel are in random order already, and taken as they are numbered.

    Args:
        rows: in any order.
        run: what they are of.
        strata: scenes, and what was changed there, of the bank that are in the run.
        arm: whose rows they are.
        left: trials that left the captured volume.

    Raises:
        StoreError: a row is not of this run, or appears twice.
    """
    found = _by_start(rows, run, strata, arm)
    order = _order(run, strata, budget_of(run))
    planned = min(len(starts) for starts in order.values())
    met = [sum((stratum, order[stratum][r]) in found for stratum in strata) for r in range(planned)]
    count = max((r + 1 for r in range(planned) if met[r] == len(strata)), default=0)
    return Rounds(
        rows={
            stratum: tuple(found.get((stratum, start)) for start in order[stratum][:count])
            for stratum in strata
        },
        starts={stratum: tuple(order[stratum][:count]) for stratum in strata},
        count=count,
        left_out=len(found) - sum(met[:count]),
        left=left,
    )


def _order(run: RunInfo, strata: Sequence[Stratum], planned: int) -> Mapping[Stratum, list[int]]:
    if run.panel == "fresh":
        return {stratum: list(range(planned)) for stratum in strata}
    starts = planned if run.drawn_from is None else run.drawn_from
    order = draw_starts(strata, starts, candidate=run.drawn_by, suite_digest=run.suite_digest)
    return {stratum: drawn[:planned] for stratum, drawn in order.items()}


def _by_start(
    rows: Iterable[Row], run: RunInfo, strata: Sequence[Stratum], arm: Arm
) -> dict[tuple[Stratum, int], Row]:
    known = set(strata)
    found: dict[tuple[Stratum, int], Row] = {}
    for row in rows:
        stratum, whose = (row.scene, row.perturbation), run.policy.checkpoint_digest
        if stratum not in known:
            place = " ".join([row.scene, *(f"{axis} {value:g}" for axis, value in stratum[1])])
            raise _foreign(row, f"the run has no {place}")
        if row.checkpoint_digest != whose:
            raise _foreign(row, f"its checkpoint is {row.checkpoint_digest[:8]}, not {whose[:8]}")
        if row.arm != arm:
            raise _foreign(row, f"it is the {row.arm}'s")
        if (stratum, row.seed_index) in found:
            raise StoreError(
                f"trial {row.trial_id} appears twice among the rows", fix="keep one row of a trial"
            )
        found[stratum, row.seed_index] = row
    return found


def _foreign(row: Row, why: str) -> StoreError:
    return StoreError(
        f"the row of trial {row.trial_id} is not of this run: {why}", fix="start a new run"
    )
