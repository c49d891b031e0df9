"""Rows to trials in the order of the draw: what the candidate scored, beside the baseline."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import isnan, nan

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import StoreError
from nw_eval.results.bank import Panel, Stratum, score
from nw_eval.results.provenance import RunInfo
from nw_eval.results.row import Row
from nw_eval.stats.bank import DrawnTrials
from nw_eval.suite.trials import DrawnStart
from nw_eval.words import Arm

Floats = NDArray[np.float64]
Places = NDArray[np.intp]


@dataclass(frozen=True, kw_only=True)
class Met:
    """All trials of a run's budget in their drawn order, with the rows of those that have ended."""

    order: Sequence[DrawnStart]
    rows: Sequence[Row | None]
    """By place; None has not ended."""
    control: Sequence[Row | None] | None = None
    """Of the baseline's policy from the same starts, where it runs beside the candidate."""
    left: frozenset[str] = frozenset()
    """Trials that left the captured volume (`gate.validity`): nothing is known of their starts."""
    control_left: frozenset[str] = frozenset()
    """Those of the control's. Each arm's trials have the same ids, and only one may have left."""

    def places(self, judged: Sequence[Stratum]) -> Places:
        """Return the places of the trials of some strata, in order, shape (T,)."""
        which = set(judged)
        found = [place for place, (*stratum, _) in enumerate(self.order) if tuple(stratum) in which]
        return np.array(found, dtype=np.intp)

    def ended(self, places: Iterable[int]) -> list[bool]:
        """Return whether each trial has ended, in both arms where there is a control."""
        return [
            self.rows[place] is not None
            and (self.control is None or self.control[place] is not None)
            for place in places
        ]

    def trials(
        self, judged: Sequence[Stratum], known: Panel | Mapping[Stratum, float]
    ) -> DrawnTrials:
        """Return the trials of some strata as numbers, shape (T,).

        A trial without a result, or that left the captured volume, is NaN; what the other arm did
        from the same start is not: the unknown side of a pair counts as whatever is worst beside
        what is known of the other, and a pair would promise less if both sides were unknown.

        Args:
            judged: the strata.
            known: the baseline's panel; or its mean success in each stratum, where the starts are
                others than the panel's. A control, if there is one, comes before it.
        """
        places = self.places(judged).tolist()
        number = {stratum: index for index, stratum in enumerate(judged)}
        strata = [(self.order[place][0], self.order[place][1]) for place in places]
        if self.control is not None:
            baseline = [self._score_beside(place) for place in places]
        elif isinstance(known, Panel):
            panels = {stratum: scores_of(known, stratum) for stratum in judged}
            baseline = [
                float(panels[stratum][self.order[place][2]])
                for stratum, place in zip(strata, places, strict=True)
            ]
        else:
            baseline = [known[stratum] for stratum in strata]
        return DrawnTrials(
            scenes=np.array([number[stratum] for stratum in strata], dtype=np.intp),
            candidate=np.array([self._score(self.rows[place]) for place in places]),
            baseline=np.array(baseline),
        )

    def scores(self, stratum: Stratum, places: Collection[int]) -> Floats:
        """Return c of the trials of a stratum among some places, NaN without a result.

        Beside a control means are of whole pairs, as the drop is: if the starts from which the
        candidate left counted for the control alone, means would be of other starts on each side.
        """
        found = [
            self._score(self.rows[place]) if self._is_whole(place) else nan
            for place in sorted(places)
            if self.order[place][:2] == stratum
        ]
        return np.array(found, dtype=np.float64)

    def of(self, stratum: Stratum, places: Collection[int]) -> list[Row]:
        """Return the rows of a stratum among some places that have a result which counts."""
        return self._whole(self.rows, stratum, places)

    def beside(self, stratum: Stratum, places: Collection[int]) -> list[Row]:
        """Return the control's rows of a stratum among some places, of pairs that count."""
        return [] if self.control is None else self._whole(self.control, stratum, places)

    def _whole(
        self, rows: Sequence[Row | None], stratum: Stratum, places: Collection[int]
    ) -> list[Row]:
        found = (place for place in sorted(places) if self.order[place][:2] == stratum)
        return [row for place in found if self._is_whole(place) and (row := rows[place])]

    def _is_whole(self, place: int) -> bool:
        """Return whether a trial has a result that counts, and its control's has one, too."""
        known = not isnan(self._score(self.rows[place]))
        return known and (self.control is None or not isnan(self._score_beside(place)))

    def _score_beside(self, place: int) -> float:
        row = None if self.control is None else self.control[place]
        counted = None if row is None or row.trial_id in self.control_left else score(row)
        return nan if counted is None else counted

    def _score(self, row: Row | None) -> float:
        counted = None if row is None or row.trial_id in self.left else score(row)
        return nan if counted is None else counted


def scores_of(panel: Panel, stratum: Stratum) -> Floats:
    """Return b of all starts of a stratum, shape (M,)."""
    return np.array([score(start) for start in panel.by_stratum[stratum]], dtype=np.float64)


def budget_of(run: RunInfo) -> int:
    """Return how many trials of each scene in each of its cells a run was to have on average."""
    return int(run.suite["trials"])


def by_place(
    rows: Iterable[Row], run: RunInfo, order: Sequence[DrawnStart], arm: Arm = "candidate"
) -> list[Row | None]:
    """Return the rows of a run by the places of their trials.

    Args:
        rows: in any order; those of strata that the order has none of, and of starts beyond the
            budget, are left out.
        run: what they are of.
        order: `draw.drawn_order`.
        arm: whose rows they are.

    Raises:
        StoreError: a row is not of this run, or appears twice.
    """
    places = {start: place for place, start in enumerate(order)}
    found: list[Row | None] = [None] * len(order)
    whose = run.policy.checkpoint_digest
    for row in rows:
        if row.scene not in run.scenes:
            raise _foreign(row, f"the run has no {row.scene}")
        if row.checkpoint_digest != whose:
            raise _foreign(row, f"its checkpoint is {row.checkpoint_digest[:8]}, not {whose[:8]}")
        if row.arm != arm:
            raise _foreign(row, f"it is the {row.arm}'s")
        place = places.get((row.scene, row.perturbation, row.seed_index))
        if place is None:
            continue
        if found[place] is not None:
            raise StoreError(
                f"trial {row.trial_id} appears twice among the rows", fix="keep one row of a trial"
            )
        found[place] = row
    return found


def _foreign(row: Row, why: str) -> StoreError:
    return StoreError(
        f"the row of trial {row.trial_id} is not of this run: {why}", fix="start a new run"
    )
