"""Limits that `nw-eval limits` wrote: read from their folder, and held against the trials there.

A folder may be somebody else's. Its limits count if each run of it is as it was when it ended, and
has the trials that the limit rests on.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nw_base.clean import clean
from nw_base.errors import StoreError
from nw_base.files.inside import OutsideError, bounded_bytes, inside
from nw_eval.api.reports import as_published
from nw_eval.reporting.html.limits import LadderLimit
from nw_gate.limits.limit import Limit

if TYPE_CHECKING:
    from nw_eval.api.reports import RunReport
    from nw_gate.results.row import Row

LIMITS_FILE = "limits.json"
_MOST = 16 * 2**20
"""Bytes of a limits.json that is read."""


def is_limits(folder: Path) -> bool:
    """Say whether a folder holds what `nw-eval limits` wrote."""
    return (folder / LIMITS_FILE).is_file() and not (folder / LIMITS_FILE).is_symlink()


def read_limits(folder: Path) -> list[tuple[LadderLimit, RunReport]]:
    """Return the limits of a folder, each with the run of its trials.

    Raises:
        StoreError: limits.json is damaged, or a run has other trials than its limit.
        UsageError: a run is missing.
    """
    path = folder / LIMITS_FILE
    try:
        saved: list[dict[str, Any]] = json.loads(bounded_bytes(path, _MOST))["limits"]
        named = [
            LadderLimit(
                policy="",
                ladder=clean(str(each["ladder"]), at_most=100),
                title=clean(str(each["title"]), at_most=200),
                limit=Limit.from_dict(each["limit"]),
                run=inside(folder, str(each["run"])),
                errors=int(each["errors"]),
            )
            for each in saved
        ]
    except (OSError, ValueError, TypeError, KeyError, RecursionError, OutsideError) as error:
        raise StoreError(f"{path} cannot be read: {error}", fix="run the search again") from error
    return [_with_run(each) for each in named]


def _with_run(each: LadderLimit) -> tuple[LadderLimit, RunReport]:
    judged = as_published(each.run)
    if _tried(judged.rows) != Counter(
        (done, tried)
        for done, tried in zip(each.limit.completed, each.limit.tried, strict=True)
        if tried
    ):
        raise StoreError(
            f"the limit on {each.ladder} is not of the trials of {each.run.name}",
            fix="run the search again",
        )
    return replace(each, policy=judged.info.policy.folder_name), judged


def _tried(rows: Sequence[Row]) -> Counter[tuple[int, int]]:
    """Return of each rung that was tried how many trials were completed, and of how many."""
    tried: Counter[object] = Counter()
    done: Counter[object] = Counter()
    for row in rows:
        if row.status == "ok":
            tried[row.scene, row.perturbation] += 1
            done[row.scene, row.perturbation] += row.completed
    return Counter((done[rung], count) for rung, count in tried.items())
