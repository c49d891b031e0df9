"""At which waypoint the candidate parts from the baseline, in scenes where it seems worse."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence

import numpy as np

from nw_eval.gate.baseline.met import Met
from nw_eval.results.bank import Panel, Start, Stratum
from nw_eval.results.row import Row
from nw_eval.stats.hazard import Ends, first_partings


def waypoints(
    strata: Iterable[Stratum], met: Met, used: Collection[int], panel: Panel
) -> Mapping[Stratum, int]:
    """Return the first waypoint, from 1, of each stratum at which the two part beyond doubt.

    The baseline is all starts of its panel, or the control's trials beside the candidate's; the
    candidate is the trials judged that came to a result. All strata are looked at together
    (`stats.hazard`), and some may have none.

    Args:
        strata: where to look.
        met: trials of the candidate.
        used: places of those that are judged.
        panel: of the baseline.
    """
    pairs = {stratum: ends(stratum, met, used, panel) for stratum in strata}
    known = {stratum: pair for stratum, pair in pairs.items() if pair is not None}
    return {stratum: found.waypoint for stratum, found in first_partings(known).items()}


def ends(
    stratum: Stratum, met: Met, used: Collection[int], panel: Panel
) -> tuple[Ends, Ends] | None:
    """Return how many trials of both ended after 0, 1, .. K waypoints; None without waypoints."""
    starts = panel.by_stratum[stratum] if met.control is None else met.beside(stratum, used)
    rows = met.of(stratum, used)
    total = max((trial.waypoints_total for trial in (*starts, *rows)), default=0)
    return (_ended(starts, total), _ended(rows, total)) if total else None


def _ended(trials: Sequence[Start | Row], total: int) -> Ends:
    reached = np.array([trial.waypoints_reached for trial in trials], dtype=np.int64)
    return [int(count) for count in np.bincount(reached, minlength=total + 1)]
