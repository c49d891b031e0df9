"""Results of policies on the robot, as a CSV that somebody kept: policy, scene, trials, success."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

from nw_eval.errors import Problem, UsageError
from nw_eval.files.inside import bounded_bytes

COLUMNS = ("policy", "scene", "trials", "success")
_MOST = 2**20  # Bytes: some 10,000 lines.
_MOST_TRIALS = 100_000


@dataclass(frozen=True, kw_only=True)
class RealResult:
    """One line: how a policy did in one scene on the robot."""

    policy: str
    """Its name, or that of the run or bank that it is compared with."""
    scene: str
    trials: int
    success: float
    """Mean over the trials, 0 to 1: of shares of waypoints reached, or of trials that succeeded."""
    place: str
    """File and line."""


def read_real_results(path: Path) -> tuple[RealResult, ...]:
    """Read a CSV with a heading that has the four columns, in any order; others are left out.

    Raises:
        UsageError: it cannot be read, lacks a column, or holds nothing; or a line's trials or
            success are no such number, or it is there twice: each fault with its line.
    """
    try:
        text = bounded_bytes(path, _MOST).decode("utf-8-sig")
        lines = csv.DictReader(text.splitlines(), strict=True)
        heading = [name.strip() for name in lines.fieldnames or ()]
        lines.fieldnames = heading
        cells = [(lines.line_num, line) for line in lines]
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}", fix="name a CSV") from None
    except (ValueError, csv.Error) as error:
        raise UsageError(f"{path} is no CSV: {error}", fix=_fix()) from None
    if missing := [name for name in COLUMNS if name not in heading]:
        raise UsageError(f"{path} lacks the column {missing[0]}", fix=_fix())
    found: list[RealResult] = []
    faults: list[Problem] = []
    for number, line in cells:
        try:
            found.append(_result(line, f"{path}:{number}", found))
        except ValueError as error:
            faults.append(Problem(file=str(path), line=number, column=1, message=str(error)))
    if faults:
        raise UsageError(faults, fix=_fix())
    if not found:
        raise UsageError(f"{path} has no results", fix=_fix())
    return tuple(found)


def _result(line: dict[str, str | None], place: str, before: list[RealResult]) -> RealResult:
    policy, scene, trials, success = ((line.get(name) or "").strip() for name in COLUMNS)
    if not (policy and scene):
        raise ValueError("it names no policy or no scene")
    if any((each.policy, each.scene) == (policy, scene) for each in before):
        raise ValueError(f"policy {policy!r} in scene {scene!r} is there twice")
    if not (trials.isascii() and trials.isdigit() and 1 <= int(trials) <= _MOST_TRIALS):
        raise ValueError(f"trials {trials!r} is no whole number from 1 to {_MOST_TRIALS}")
    try:
        share = float(success)
    except ValueError:
        share = -1.0
    if not 0.0 <= share <= 1.0:
        raise ValueError(f"success {success!r} is not between 0 and 1")
    return RealResult(policy=policy, scene=scene, trials=int(trials), success=share, place=place)


def _fix() -> str:
    return f"write a heading `{','.join(COLUMNS)}` and a line for each policy and scene"
