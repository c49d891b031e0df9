"""Which trials' logs are read for a page: all failures first, and no scene is left without."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence

from nw_eval.reporting.tables.table import WORST
from nw_eval.reporting.tables.trials import worst_trials
from nw_eval.results.row import Row

MOST_PATHS = 320
"""Trials whose walks are drawn: of 160 all, and some hundred of thousands that look alike."""
MOST_CLIPS = 16


def drawn_trials(rows: Iterable[Row], most: int = MOST_PATHS) -> list[Row]:
    """Return the trials whose walks are drawn: failures first, by turns of the scenes.

    Errors of the machine are none of the policy's and are not among them.
    """
    found: list[tuple[bool, int, str, Row]] = []
    counts: defaultdict[tuple[str, bool], int] = defaultdict(int)
    for row in sorted(rows, key=lambda row: row.trial_id):
        if row.status == "ok":
            turn = counts[row.scene, row.completed]
            counts[row.scene, row.completed] += 1
            found.append((row.completed, turn, row.trial_id, row))
    return [row for *_, row in sorted(found, key=lambda entry: entry[:3])[:most]]


def clipped_trials(rows: Sequence[Row], most: int = MOST_CLIPS) -> list[Row]:
    """Return failures, the worst first: those that a page names, and then one of every scene."""
    failed = worst_trials(rows)
    firsts = {row.scene: row for row in reversed(failed)}
    others = [row for row in failed[WORST:] if row is firsts[row.scene]]
    return [*failed[:WORST], *others][:most]
