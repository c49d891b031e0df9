"""At which waypoint the candidate parts from the baseline, in scenes where it seems worse."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from nw_eval.gate.baseline.rounds import Rounds
from nw_eval.results.bank import Panel, Start, Stratum
from nw_eval.results.row import Row
from nw_eval.stats.hazard import Ends, first_partings


def waypoints(strata: Iterable[Stratum], rounds: Rounds, panel: Panel) -> Mapping[Stratum, int]:
    """Return the first waypoint, from 1, of each stratum at which the two part beyond doubt.

    The baseline is all starts of its panel, the candidate the trials of the rounds that came to a
    result; all strata are looked at together (`stats.hazard`), and some may have none.

    Args:
        strata: where to look.
        rounds: of the candidate.
        panel: of the baseline.
    """
    pairs = {stratum: ends(stratum, rounds, panel) for stratum in strata}
    known = {stratum: pair for stratum, pair in pairs.items() if pair is not None}
    return {stratum: found.waypoint for stratum, found in first_partings(known).items()}


def ends(stratum: Stratum, rounds: Rounds, panel: Panel) -> tuple[Ends, Ends] | None:
    """Return how many trials of both ended after 0, 1, .. K waypoints; None without waypoints."""
    starts = panel.by_stratum[stratum]
    rows = [row for row in rounds.rows[stratum] if row is not None and rounds.counts(row)]
    total = max(trial.waypoints_total for trial in (*starts, *rows))
    return (_ended(starts, total), _ended(rows, total)) if total else None


def _ended(trials: Sequence[Start | Row], total: int) -> Ends:
    reached = np.array([trial.waypoints_reached for trial in trials], dtype=np.int64)
    return [int(count) for count in np.bincount(reached, minlength=total + 1)]
