"""Results of policies on the robot, as a CSV that somebody kept: policy, scene, trials, success.

In place of success it may have a score of docs/reference/scores.md, in a column of its name. A
table of limits has policy, ladder, and limit or lower and upper.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from nw_base.errors import Problem, UsageError
from nw_base.files.inside import bounded_bytes
from nw_gate.scores import ScoreSpec

_NAMED = ("policy", "scene", "trials")
_MOST = 2**20  # Bytes: some 10,000 lines.
_MOST_TRIALS = 100_000


@dataclass(frozen=True, kw_only=True)
class RealResult:
    """One line: how a policy did in one scene on the robot."""

    policy: str
    """Its name, or that of the run or baseline that it is compared with."""
    scene: str
    trials: int
    success: float
    """Mean over the trials, 0 to 1: of shares of waypoints reached, or of trials that succeeded; of
    a score, its mean on that scale, 1 the best."""
    place: str
    """File and line."""


def read_real_results(path: Path, spec: ScoreSpec | None = None) -> tuple[RealResult, ...]:
    """Read a CSV with a heading that has the four columns, in any order; others are left out.

    Commas, semicolons or tabs separate cells. With the latter two, numbers may have a decimal
    comma, as spreadsheets write them.

    Args:
        path: of the CSV, in UTF-8, or UTF-16 with its mark.
        spec: of the score whose column is read, in its unit; None = success.

    Raises:
        UsageError: it cannot be read, lacks a column, or holds nothing; or a line's trials or
            value are no such number, or it is there twice: each fault with its line.
    """
    columns = (*_NAMED, "success" if spec is None else spec.name)
    fix = f"write a heading `{','.join(columns)}` and a line for each policy and scene"

    def parsed(cells: Sequence[str], place: str, before: list[RealResult]) -> RealResult:
        return _result(cells, place, before, spec)

    return _read(path, lambda _: columns, fix, parsed)


@dataclass(frozen=True, kw_only=True)
class RealLimit:
    """One line: how far a policy went on a ladder on the robot, in the ladder's unit."""

    policy: str
    ladder: str
    lower: float | None
    """The hardest value that was still cleared; None: none was."""
    upper: float | None
    """The easiest value that was not cleared; None: all were."""
    place: str
    """File and line."""


def read_real_limits(path: Path) -> tuple[RealLimit, ...]:
    """Read a CSV of limits, as `read_real_results` reads one of success.

    Its columns are policy, ladder and limit; or policy, ladder, lower and upper, of which one may
    be empty.

    Args:
        path: of the CSV.

    Raises:
        UsageError: as `read_real_results`.
    """

    def columns(heading: Sequence[str]) -> tuple[str, ...]:
        return (*_CLIMBED, *(("limit",) if "limit" in heading else ("lower", "upper")))

    fix = (
        "write a heading `policy,ladder,limit` or `policy,ladder,lower,upper` and a line for each "
        "policy and ladder"
    )
    return _read(path, columns, fix, _limit)


_CLIMBED = ("policy", "ladder")
_R = TypeVar("_R", RealResult, RealLimit)


def _read(
    path: Path,
    columns: Callable[[Sequence[str]], Sequence[str]],
    fix: str,
    parsed: Callable[[Sequence[str], str, list[_R]], _R],
) -> tuple[_R, ...]:
    """Return the lines of a CSV.

    Args:
        path: of it.
        columns: returns those that are read, of a heading.
        fix: what to do about a fault.
        parsed: returns what a line says, of its cells, its place, and the lines before; it raises
            ValueError.
    """
    try:
        cells = _cells(path, columns)
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}", fix="name a CSV") from None
    except LookupError as error:
        raise UsageError(f"{path} {error.args[0]}", fix=fix) from None
    except (ValueError, csv.Error) as error:
        raise UsageError(f"{path} is not a CSV: {error}", fix=fix) from None
    results: list[_R] = []
    faults: list[Problem] = []
    for number, wanted in cells:
        try:
            results.append(parsed(wanted, f"{path}:{number}", results))
        except ValueError as error:
            faults.append(Problem(file=str(path), line=number, column=1, message=str(error)))
    if faults:
        raise UsageError(faults, fix=fix)
    if not results:
        raise UsageError(f"{path} has no results", fix=fix)
    return tuple(results)


def _cells(
    path: Path, columns: Callable[[Sequence[str]], Sequence[str]]
) -> list[tuple[int, list[str]]]:
    """Return the number and the cells of each line that is not empty; raises LookupError, too."""
    data = bounded_bytes(path, _MOST)
    text = data.decode("utf-16" if data[:2] in {b"\xff\xfe", b"\xfe\xff"} else "utf-8-sig")
    delimiter = max(",;\t", key=text.partition("\n")[0].count)
    reader = csv.reader(text.splitlines(), delimiter=delimiter, strict=True)
    heading = [name.strip().lower() for name in next(reader, [])]
    wanted_names = columns(heading)
    for name in wanted_names:
        if (count := heading.count(name)) != 1:
            raise LookupError(f"lacks the column {name}" if not count else f"has {name} twice")
    rows: list[tuple[int, list[str]]] = []
    for line in reader:
        if len(line) > len(heading):
            raise LookupError(f"has more cells in line {reader.line_num} than in its heading")
        row = dict(zip(heading, map(str.strip, line), strict=False))
        wanted = [row.get(name, "") for name in wanted_names]
        if delimiter != ",":
            last = len(_CLIMBED) if "ladder" in wanted_names else len(_NAMED)
            wanted[last:] = [cell.replace(",", ".") for cell in wanted[last:]]
        if any(map(str.strip, line)):
            rows.append((reader.line_num, wanted))
    return rows


def _result(
    cells: Sequence[str], place: str, before: list[RealResult], spec: ScoreSpec | None
) -> RealResult:
    policy, scene, trials, written = cells
    trials = trials.removesuffix(".0").removesuffix(",0")  # pandas writes 10.0
    if not (policy and scene):
        raise ValueError("it names no policy or no scene")
    if any((each.policy, each.scene) == (policy, scene) for each in before):
        raise ValueError(f"policy {policy!r} in scene {scene!r} is there twice")
    if not (trials.isascii() and trials.isdigit() and 1 <= int(trials) <= _MOST_TRIALS):
        raise ValueError(f"trials {trials!r} is not a whole number from 1 to {_MOST_TRIALS}")
    name = "success" if spec is None else spec.name
    share = spec is None and written.endswith("%")
    try:
        value = float(written.rstrip("%")) / 100.0 if share else float(written)
    except ValueError:
        value = math.nan
    if spec is not None:
        if not math.isfinite(value):
            raise ValueError(f"{name} {written!r} is not a number")
        value = spec.scaled(value)
    if not 0.0 <= value <= 1.0:
        raise ValueError(f"success {written!r} is not between 0 and 1")
    return RealResult(policy=policy, scene=scene, trials=int(trials), success=value, place=place)


def _limit(cells: Sequence[str], place: str, before: list[RealLimit]) -> RealLimit:
    policy, ladder, *written = cells
    if not (policy and ladder):
        raise ValueError("it names no policy or no ladder")
    if any((each.policy, each.ladder) == (policy, ladder) for each in before):
        raise ValueError(f"policy {policy!r} on ladder {ladder!r} is there twice")
    values: list[float | None] = []
    for text in written:
        try:
            value = float(text) if text else None
        except ValueError:
            value = math.nan
        if value is not None and not math.isfinite(value):
            raise ValueError(f"limit {text!r} is not a number")
        values.append(value)
    if values == [None] * len(values):
        raise ValueError("it has no limit")
    return RealLimit(policy=policy, ladder=ladder, lower=values[0], upper=values[-1], place=place)
