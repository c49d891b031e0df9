"""A run's progress as records of Python's logging, which pytest shows to whoever asks for it."""

from __future__ import annotations

from logging import getLogger
from typing import TYPE_CHECKING

from nw_eval.clean import clean

if TYPE_CHECKING:
    from nw_eval.results.row import Row

_LOGGER = getLogger("nw_eval")


class Log:
    """A listener that logs: `pytest --log-cli-level=INFO` shows its lines as they come."""

    def __init__(self) -> None:
        self._total = self._finished = 0

    def message(self, text: str) -> None:
        """Log a line for people."""
        _LOGGER.info("%s", clean(text))

    def scene(self, name: str, fraction: float) -> None:
        """Log that a scene's splat is made."""
        if fraction >= 1.0:
            _LOGGER.info("%s is ready", clean(name))

    def planned(self, *, total: int, finished: int) -> None:
        """Log how many trials there are."""
        self._total, self._finished = total, finished
        _LOGGER.info("%d of %d trials to run", total - finished, total)

    def trial(self, row: Row) -> None:
        """Log how a trial ended."""
        self._finished += 1
        _LOGGER.info(
            "%d of %d: %s %s", self._finished, self._total, clean(row.trial_id), row.outcome
        )
