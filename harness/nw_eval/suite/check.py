"""Whether the scene names of a suite's tiers mean scenes that it runs."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import PurePosixPath

from nw_eval.errors import Problem, nearest
from nw_eval.suite.load import Draft


def tier_problems(draft: Draft, selected: Sequence[str], failed: Sequence[str]) -> list[Problem]:
    """Return a problem for each tier that names no scene of the suite.

    Args:
        draft: the suite, as far as it could be read.
        selected: names of the scenes that it runs, and of those it may mean where `failed`.
        failed: its entries that could not be opened. A tier that may be about one is left alone,
            for it would only echo that fault.
    """
    perhaps = [name for entry in failed for name in folder_names(entry)]
    return [
        draft.source.problem(
            ("gate", "tiers", pattern),
            f"gate.tiers: the suite runs no scene {pattern!r}",
            nearest(pattern, selected),
        )
        for pattern in draft.tiers
        if not any(fnmatchcase(name, pattern) for name in (*selected, *perhaps))
    ]


def folder_names(entry: str) -> list[str]:
    """Return what the scene of a folder may be called: as the folder, or with the one around it."""
    parts = PurePosixPath(entry.rpartition(":")[2]).parts
    return ["/".join(parts[-count:]) for count in (1, 2)]
