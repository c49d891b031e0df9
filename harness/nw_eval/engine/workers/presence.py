"""Notices that a run's folder has been removed, or another one put in its place."""

from __future__ import annotations

from pathlib import Path

from nw_eval.errors import StoreError


class Presence:
    """Remembers which file a journal is, to find out whether it still lies where it did.

    A process may go on writing to a file that has been removed; what it writes is lost.
    """

    def __init__(self, journal: Path) -> None:
        self._journal = journal
        self._known = _identity(journal)

    def check(self) -> None:
        """Do nothing while the file is in its place.

        Raises:
            StoreError: it is not.
        """
        if self._known is None or _identity(self._journal) != self._known:
            raise StoreError(
                f"{self._journal.parent} was removed or replaced while the run went on",
                fix="put it back and continue with --resume, or run again",
            )


def _identity(path: Path) -> tuple[int, int] | None:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_dev, status.st_ino
