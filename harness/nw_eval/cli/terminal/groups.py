"""Parts of a log that GitHub folds behind a title."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager

from nw_eval.cli.terminal.last_words import tell


@contextmanager
def group(title: str, *, wanted: bool) -> Generator[None]:
    """Fold what is said meanwhile on standard error, if that is wanted.

    Args:
        title: what is shown of it.
        wanted: whether GitHub's runner reads it.
    """
    if not wanted:
        yield
        return
    from nw_eval.reporting.github.commands import END_GROUP, begin_group

    tell(begin_group(title))
    try:
        yield
    finally:
        tell(END_GROUP)
