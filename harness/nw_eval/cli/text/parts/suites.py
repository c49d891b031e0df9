"""Suites that can be asked for by name, as a table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from nw_eval.cli.text.table import aligned

if TYPE_CHECKING:
    from nw_eval.api import ListedSuite


def suite_table(suites: Sequence[ListedSuite]) -> str:
    """Return a line for each suite: name, scenes and trials, bar, purpose; or what is wrong."""
    if not suites:
        return "no suites: neither shipped, nor in ./suites"
    return "\n".join(aligned([(suite.name, *_words(suite)) for suite in suites]))


def _words(suite: ListedSuite) -> tuple[str, str, str]:
    if suite.problem is not None:
        return "?", "?", suite.problem
    bar = "no bar" if suite.bar is None else f"bar {suite.bar:g}"
    return f"{suite.scenes} scenes x {suite.trials}", bar, suite.purpose
