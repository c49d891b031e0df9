"""What one sees while something is fetched: a bar on a terminal, lines in a log."""

from __future__ import annotations

import time
from collections.abc import Generator
from contextlib import contextmanager
from functools import cached_property
from typing import TYPE_CHECKING

from nw_base.clean import clean
from nw_base.plural import in_words
from nw_scenes.hub import heard_by

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress

_LOG_EVERY = 10.0  # Seconds between two lines where there is no terminal.


class FetchProgress:
    """Listens to what a verb fetches; silent, and of no cost, as long as it fetches nothing."""

    def __init__(self) -> None:
        self._bar: Progress | None = None  # While a file comes: a run has bars of its own.
        self._messages: set[str] = set()
        self._last_line_at = time.perf_counter()

    def message(self, text: str) -> None:
        """Say one line, once."""
        if text not in self._messages:
            self._messages.add(text)
            self._say(text)

    def fetching(self, name: str, done: int, total: int) -> None:
        """Show how many bytes of a file are here."""
        now = time.perf_counter()
        if done >= total:
            self.stop()
        elif self._console.is_terminal:
            if self._bar is None:
                self._bar = _bar(self._console)
                self._bar.add_task(clean(name, at_most=40), total=total)
                self._bar.start()
            self._bar.update(self._bar.task_ids[0], completed=done)
        elif now - self._last_line_at >= _LOG_EVERY:
            self._last_line_at = now
            self._say(f"{name}: {in_words(done)} of {in_words(total)}")

    def stop(self) -> None:
        """Take the bar away."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    @cached_property
    def _console(self) -> Console:
        from rich.console import Console

        return Console(stderr=True)

    def _say(self, text: str) -> None:
        self._console.print(clean(text), highlight=False, markup=False, soft_wrap=True)


def _bar(console: Console) -> Progress:
    from rich.progress import (
        BarColumn,
        DownloadColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
        TransferSpeedColumn,
    )

    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        DownloadColumn(),
        TransferSpeedColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        # What a verb prints is for its own reader.
        redirect_stdout=False,
        redirect_stderr=False,
    )


@contextmanager
def fetches_shown() -> Generator[None]:
    """Show what is fetched while the context lasts."""
    progress = FetchProgress()
    try:
        with heard_by(progress):
            yield
    finally:
        progress.stop()
