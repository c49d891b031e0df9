"""The second pass over a suite: whether its scene names mean scenes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from nw_eval.errors import Problem, SuiteError, nearest
from nw_eval.suite.model import Suite


def is_path(pattern: str, base: Path) -> bool:
    """Say whether an entry of `scenes` is a place in the file system, not a catalogue's name.

    Args:
        pattern: a name, a glob, or a path.
        base: folder that relative paths start from.
    """
    if pattern.startswith(("neverwhere:", "flex:", "split:", ".", "/", "~")):
        return True
    try:
        return (base / pattern).exists() or any(base.glob(pattern))
    except (OSError, ValueError):  # Too long for a path, or no glob that pathlib understands.
        return False


def check_scenes(suite: Suite, names: Iterable[str]) -> None:
    """Check every scene pattern and tier against the names of the catalogue.

    Entries that are paths are left to whoever opens them; with such entries the tiers are left
    too, for `check_tiers`, because only the opened scenes know their names.

    Raises:
        SuiteError: patterns or tiers match nothing, all of them told.
    """
    known = sorted(names)
    unknown = {index: p for index, p in enumerate(suite.scenes) if not _matches(p, known)}
    paths = {index: p for index, p in unknown.items() if is_path(p, suite.base)}
    problems = [
        suite.source.problem(
            ("scenes", index), f"no scene matches {pattern!r}", nearest(pattern, known)
        )
        for index, pattern in unknown.items()
        if index not in paths
    ]
    if not paths:
        chosen = [name for name in known if any(fnmatchcase(name, p) for p in suite.scenes)]
        problems += _tier_problems(suite, chosen)
    if problems:
        raise SuiteError(sorted(problems, key=lambda problem: (problem.line, problem.column)))


def check_tiers(suite: Suite, selected: Sequence[str]) -> None:
    """Check every tier against the names of the scenes that the suite runs.

    Raises:
        SuiteError: tiers match none of them.
    """
    if problems := _tier_problems(suite, selected):
        raise SuiteError(problems)


def _tier_problems(suite: Suite, selected: Sequence[str]) -> list[Problem]:
    return [
        suite.source.problem(
            ("gate", "tiers", pattern),
            f"gate.tiers: the suite runs no scene {pattern!r}",
            nearest(pattern, selected),
        )
        for pattern in suite.gate.tiers
        if not _matches(pattern, selected)
    ]


def _matches(pattern: str, names: Sequence[str]) -> bool:
    return any(fnmatchcase(name, pattern) for name in names)
