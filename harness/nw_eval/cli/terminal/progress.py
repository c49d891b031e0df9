"""What one sees while scenes are built and trials run: bars on a terminal, lines in a log."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import wraps
from types import TracebackType
from typing import TYPE_CHECKING, Concatenate, ParamSpec, Self

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TaskID, TextColumn
from rich.text import Text

from nw_base.clean import clean
from nw_eval.cli.terminal.final_output import tell, unforeseen
from nw_eval.cli.terminal.time_left import TimeLeft

if TYPE_CHECKING:
    from nw_gate.results.row import Row

_P = ParamSpec("_P")

_LOG_EVERY = 10.0  # Seconds between two lines where there is no terminal.
_TRIALS = "trials"


def _harmless(
    show: Callable[Concatenate[RunProgress, _P], None],
) -> Callable[Concatenate[RunProgress, _P], None]:
    """Let a method fail without costing the run: what it shows is in the journal as well."""

    @wraps(show)
    def try_to(self: RunProgress, *args: _P.args, **kwargs: _P.kwargs) -> None:
        if not self.is_broken:
            try:
                show(self, *args, **kwargs)
            except Exception as error:  # noqa: BLE001 - a terminal may break in any way.
                self.is_broken = True
                tell(f"warning: no more progress is shown, {unforeseen(error)}")

    return try_to


class _TimeLeftColumn(ProgressColumn):
    """The time that the trials still take, renewed twice a second; nothing for other bars."""

    max_refresh = 0.5

    def __init__(self, left: TimeLeft) -> None:
        super().__init__()
        self._left = left

    def render(self, task: Task) -> Text:
        """Return the column's text for a bar."""
        if task.description != _TRIALS or task.total is None:
            return Text()
        return Text(self._left.in_words(round(task.total - task.completed)))


class RunProgress:
    """Listens to `api.run`: scene building, then trials with their rate and success so far.

    Args:
        bars: whether a terminal shows bars. They would be drawn over a debugger's prompt.
    """

    def __init__(self, *, bars: bool = True) -> None:
        self.is_broken = False
        self._console = Console(stderr=True)
        self._left = TimeLeft()
        self._bars = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.fields[note]}"),
            _TimeLeftColumn(self._left),
            console=self._console,
            transient=True,
            disable=not (bars and self._console.is_terminal),
        )
        self._tasks: dict[str, TaskID] = {}
        self._total = 0
        self._done = 0
        self._fresh = 0
        self._errors = 0
        self._successes: list[float] = []
        self._began = self._last_line_at = time.perf_counter()

    def __enter__(self) -> Self:
        self._start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stop()

    @_harmless
    def _start(self) -> None:
        self._bars.start()

    @_harmless
    def _stop(self) -> None:
        self._bars.stop()

    @_harmless
    def message(self, text: str) -> None:
        """Say one line above the bars, whatever untrusted words are in it."""
        self._console.print(clean(text), highlight=False, markup=False, soft_wrap=True)

    @_harmless
    def scene(self, name: str, fraction: float) -> None:
        """Show that a scene is being built, from 0 to 1."""
        label = f"building {name}"
        if label not in self._tasks:
            self._tasks[label] = self._bars.add_task(label, total=1.0, note="")
            if self._bars.disable:
                self.message(label)
        self._bars.update(self._tasks[label], completed=fraction, visible=fraction < 1.0)

    @_harmless
    def planned(self, *, total: int, finished: int) -> None:
        """Show how many trials there are, and how many an earlier run already finished."""
        self._total, self._done = total, finished
        self._began = self._last_line_at = time.perf_counter()
        self._fresh, self._errors, self._successes = 0, 0, []
        self._left.restart()
        if _TRIALS in self._tasks:  # The baseline's own, which ran first.
            self._bars.remove_task(self._tasks[_TRIALS])
        self._tasks[_TRIALS] = self._bars.add_task(
            _TRIALS, total=total, completed=finished, note=""
        )
        if finished:
            self.message(f"resuming: {finished} of {total} trials are already finished")

    @_harmless
    def trial(self, row: Row) -> None:
        """Show one more finished trial."""
        self._done += 1
        self._fresh += 1
        self._left.ended()
        if row.success is not None:
            self._successes.append(row.success)
        else:
            self._errors += 1
            self.message(f"trial {row.trial_id}: {row.error_type}: {row.error_text}")
        note = self._note()
        if self._bars.disable:
            now = time.perf_counter()
            if now - self._last_line_at >= _LOG_EVERY or self._done == self._total:
                self._last_line_at = now
                left = self._left.in_words(self._total - self._done)
                words = (f"{self._done}/{self._total} trials", note, left)
                self.message(", ".join(word for word in words if word))
        else:
            self._bars.update(self._tasks[_TRIALS], completed=self._done, note=note)

    def _note(self) -> str:
        minutes = max(time.perf_counter() - self._began, 1e-9) / 60.0
        success = sum(self._successes) / len(self._successes) if self._successes else 0.0
        note = f"{self._fresh / minutes:.0f} a minute, success so far {success:.2f}"
        return f"{note}, {self._errors} errors" if self._errors else note
