"""Whether the scene names of a suite's tiers mean scenes that it runs."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import PurePosixPath

from nw_eval.errors import Problem, nearest
from nw_eval.suite.load import Draft


def tier_problems(draft: Draft, selected: Sequence[str], failed: Sequence[str]) -> list[Problem]:
    """Return a problem for each tier that names no scene of the suite, or decides for none.

    The first glob wins: one behind another that covers all of its scenes changes nothing.

    Args:
        draft: the suite, as far as it could be read.
        selected: names of the scenes that it runs, and of those it may mean where `failed`.
        failed: its entries that could not be opened. A tier that may be about one is left alone,
            for it would only echo that fault.
    """
    perhaps = [name for entry in failed for name in folder_names(entry)]
    unmeant = [
        draft.source.problem(
            ("gate", "tiers", pattern),
            f"gate.tiers: the suite runs no scene {pattern!r}",
            nearest(pattern, selected),
        )
        for pattern in draft.tiers
        if not any(fnmatchcase(name, pattern) for name in (*selected, *perhaps))
    ]
    return unmeant + [
        draft.source.problem(
            ("gate", "tiers", pattern),
            f"gate.tiers: {pattern!r} decides for no scene: {before!r} comes before it and is "
            "about all of its scenes",
            f"write {pattern!r} before {before!r}",
        )
        for pattern, before in _shadowed(draft.tiers, selected)
    ]


def _shadowed(tiers: Sequence[str], selected: Sequence[str]) -> list[tuple[str, str]]:
    """Return each glob whose scenes are all decided by globs before it, and one of these."""
    found: list[tuple[str, str]] = []
    for place, pattern in enumerate(tiers):
        scenes = [name for name in selected if fnmatchcase(name, pattern)]
        if pattern in scenes:
            continue  # An exact name wins, wherever it stands.
        winners = [
            next((before for before in tiers[:place] if fnmatchcase(name, before)), None)
            for name in scenes
            if name not in tiers
        ]
        if winners and winners[0] is not None and None not in winners:
            found.append((pattern, winners[0]))
    return found


def folder_names(entry: str) -> list[str]:
    """Return what the scene of a folder may be called: as the folder, or with the one around it."""
    parts = PurePosixPath(entry.rpartition(":")[2]).parts
    return ["/".join(parts[-count:]) for count in (1, 2)]
