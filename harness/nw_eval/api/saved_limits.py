"""Limits that `nw-eval limits` wrote, read from their folder again.

A folder may be somebody else's. For a public page its limits count if each run of it is as it was
when it ended, and has the trials that the limit rests on.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nw_base.clean import clean
from nw_base.errors import NwEvalError, StoreError, UsageError
from nw_base.files.inside import OutsideError, bounded_bytes, inside, what_is
from nw_eval.reporting.html.limits import LadderLimit
from nw_gate.limits.limit import Limit

if TYPE_CHECKING:
    from nw_eval.api.reports import RunReport
    from nw_gate.results.row import Row

_NAME = "limits.json"
_MOST = 16 * 2**20
"""Bytes of a file."""
_FIX = "find the limits again with `nw-eval limits`"


def limits_file(path: Path) -> Path | None:
    """Return the file of limits that a path names or that its folder holds; None if it is none."""
    if path.name == _NAME and what_is(path) == "file":
        return path
    return path / _NAME if what_is(path / _NAME) == "file" else None


def read_limits(path: Path) -> tuple[LadderLimit, ...]:
    """Return the limits in a folder of `nw-eval limits`, or in its `limits.json`.

    Raises:
        UsageError: there is no such file.
        StoreError: it cannot be read, or is none.
    """
    file = limits_file(path)
    if file is None:
        raise UsageError(
            f"{path} holds no limits (no {_NAME} in it)",
            fix="name a folder that `nw-eval limits` wrote",
        )
    try:
        return _read(file)
    except StoreError as error:
        raise StoreError(f"{file}: {error.message}", fix=_FIX) from None
    except KeyError as error:
        raise StoreError(f"{file} lacks {error}", fix=_FIX) from None
    except (OSError, ValueError, TypeError, OverflowError, RecursionError, OutsideError) as error:
        raise StoreError(f"{file} cannot be read: {error}", fix=_FIX) from None


def verified_limits(folder: Path) -> list[tuple[LadderLimit, RunReport]]:
    """Return the limits of a folder, each with the run of its trials.

    Raises:
        StoreError: limits.json is damaged, or a run has other trials than its limit.
        UsageError: it, or a run, is missing.
    """
    return [_with_run(each) for each in read_limits(folder)]


def _read(file: Path) -> tuple[LadderLimit, ...]:
    content = json.loads(bounded_bytes(file, _MOST))
    if content["nw-limits"] != 1:
        raise ValueError(f"its version is {content['nw-limits']!r}, not 1")
    return tuple(_saved(each, file) for each in content["limits"])


def _saved(entry: Any, file: Path) -> LadderLimit:
    return LadderLimit(
        policy=clean(str(entry["policy"]), at_most=200),
        ladder=clean(str(entry["ladder"]), at_most=200),
        title=clean(str(entry.get("title", "")), at_most=200),
        limit=Limit.from_dict(entry["limit"]),
        run=inside(file.parent, str(entry["run"])),
        errors=int(entry.get("errors", 0)),
    )


def _with_run(each: LadderLimit) -> tuple[LadderLimit, RunReport]:
    from nw_eval.api.reports import as_published

    judged = as_published(each.run)
    if _tried(judged.rows) != Counter(
        (done, tried)
        for done, tried in zip(each.limit.completed, each.limit.tried, strict=True)
        if tried
    ):
        raise StoreError(
            f"the limit on {each.ladder} is not of the trials of {each.run.name}", fix=_FIX
        )
    if fault := _fault_of(each, judged.rows):
        raise StoreError(f"the limit on {each.ladder} is not of that ladder: {fault}", fix=_FIX)
    return replace(each, policy=judged.info.policy.folder_name), judged


def _fault_of(each: LadderLimit, rows: Sequence[Row]) -> str:
    """Return what of a limit is not as of its ladder, if that is known here; empty if nothing."""
    from nw_sim.ladders import ladder_named

    try:
        rungs = ladder_named(each.ladder).rungs
    except (NwEvalError, OSError):
        return ""
    if tuple(rung.value for rung in rungs) != each.limit.ladder.rungs:
        return "its rungs are others"
    others = {row.scene for row in rows} - {rung.scene for rung in rungs}
    return f"its trials are in {min(others)}" if others else ""


def _tried(rows: Sequence[Row]) -> Counter[tuple[int, int]]:
    """Return of each rung that was tried how many trials were completed, and of how many."""
    tried: Counter[object] = Counter()
    done: Counter[object] = Counter()
    for row in rows:
        if row.status == "ok":
            tried[row.scene, row.perturbation] += 1
            done[row.scene, row.perturbation] += row.completed
    return Counter((done[rung], count) for rung, count in tried.items())
