"""What of a run's results comes from earlier runs, in one sentence."""

from __future__ import annotations

from collections.abc import Sequence

from nw_eval.results.provenance import RunInfo
from nw_eval.results.row import Row


def taken_over(run: RunInfo, rows: Sequence[Row]) -> str:
    """Return how many results the cache of trials had, and how many of them ran again.

    Empty where it had none.
    """
    hits = sum(row.cached for row in rows)
    again = 0 if run.cache is None else run.cache.reexecuted
    if not hits and not again:
        return ""
    text = f"{hits} of {len(rows)} results are from earlier runs, by the cache of trials"
    if run.cache is None or not again:
        return f"{text}."
    wrong = len(run.cache.differing)
    came = f"{wrong} of them came to other bits" if wrong else "came to the same bits"
    return f"{text}; {again} more ran again to be compared, and {came}."
