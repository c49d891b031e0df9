"""What one sees while something is fetched: a bar on a terminal, lines in a log."""

from __future__ import annotations

import time
from collections.abc import Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from nw_eval.amounts import in_words
from nw_eval.clean import clean
from nw_eval.hub.listener import heard_by

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

_LOG_EVERY = 10.0  # Seconds between two lines where there is no terminal.


class FetchProgress:
    """Listens to what a verb fetches; silent, and of no cost, as long as it fetches nothing."""

    def __init__(self) -> None:
        self._bars: Progress | None = None
        self._tasks: dict[str, TaskID] = {}
        self._messages: set[str] = set()
        self._last_line_at = time.perf_counter()

    def message(self, text: str) -> None:
        """Say one line, once."""
        if text not in self._messages:
            self._messages.add(text)
            self._shown().console.print(clean(text), highlight=False, markup=False, soft_wrap=True)

    def fetching(self, name: str, done: int, total: int) -> None:
        """Show how many bytes of a file are here."""
        bars = self._shown()
        if bars.disable:
            now = time.perf_counter()
            if done < total and now - self._last_line_at >= _LOG_EVERY:
                self._last_line_at = now
                bars.console.print(
                    f"{clean(name)}: {in_words(done)} of {in_words(total)}",
                    highlight=False,
                    markup=False,
                    soft_wrap=True,
                )
            return
        if name not in self._tasks:
            self._tasks[name] = bars.add_task(clean(name, at_most=40), total=total)
        bars.update(self._tasks[name], completed=done, visible=done < total)

    def stop(self) -> None:
        """Take the bars away."""
        if self._bars is not None:
            self._bars.stop()

    def _shown(self) -> Progress:
        if self._bars is None:
            from rich.console import Console
            from rich.progress import (
                BarColumn,
                DownloadColumn,
                Progress,
                TextColumn,
                TimeRemainingColumn,
                TransferSpeedColumn,
            )

            console = Console(stderr=True)
            self._bars = Progress(
                TextColumn("{task.description}", markup=False),
                BarColumn(),
                DownloadColumn(),
                TransferSpeedColumn(),
                TimeRemainingColumn(),
                console=console,
                transient=True,
                disable=not console.is_terminal,
            )
            self._bars.start()
        return self._bars


@contextmanager
def fetches_shown() -> Generator[None]:
    """Show what is fetched while the context lasts."""
    progress = FetchProgress()
    try:
        with heard_by(progress):
            yield
    finally:
        progress.stop()
