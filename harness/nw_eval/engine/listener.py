"""Who is told how a run goes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from nw_gate.results.row import Row


class Listener(Protocol):
    """Hears of a run's progress, in the process that started it.

    `cli.terminal.progress` draws bars.
    """

    def message(self, text: str) -> None:
        """Hear one line for people."""
        ...

    def scene(self, name: str, fraction: float) -> None:
        """Hear how far a scene's splat has been built, 0 to 1."""
        ...

    def planned(self, *, total: int, finished: int) -> None:
        """Hear how many trials there are, and how many an earlier run has finished."""
        ...

    def trial(self, row: Row) -> None:
        """Hear of one more finished trial."""
        ...


class NullListener:
    """A listener that does nothing."""

    def message(self, text: str) -> None:
        """Ignore it."""

    def scene(self, name: str, fraction: float) -> None:
        """Ignore it."""

    def planned(self, *, total: int, finished: int) -> None:
        """Ignore it."""

    def trial(self, row: Row) -> None:
        """Ignore it."""
