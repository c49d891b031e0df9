"""`nw-eval view`: look at trials in the browser."""

from __future__ import annotations

import signal
import threading
from dataclasses import dataclass
from pathlib import Path

import tyro

from nw_eval.errors import UsageError, nearest


@dataclass(frozen=True, kw_only=True)
class ViewTrials:
    """Show a trial in the browser from its log, till Ctrl-C: place, robot, pictures, plots.

    Play, step and scrub; jump to waypoints and to where two trials part. Nothing runs: what is
    shown is what was logged.
    """

    source: tyro.conf.Positional[Path]
    """A trial's log, or a run's folder, whose trials can be chosen on the page."""
    against: Path | None = None
    """Another log, or another run's folder: its trials of the same names walk along as ghosts."""
    trial: str = ""
    """Trial of a run that is shown first, by its name in the report."""
    at: float = 0.0
    """Second of the trial that is shown first."""
    port: int | None = None
    """Port to listen at, on this machine's own address only; 0 chooses a free one. Without it:
    8720, where the links of reports lead, or a free one if that is in use."""
    open: bool = False
    """Open the page in this machine's browser."""

    def __call__(self) -> int:
        from nw_eval.results.moment_link import PORT
        from nw_eval.view.loading import open_shelf
        from nw_eval.view.page import ViewPage
        from nw_eval.viewing.browser.library import check_server, free_port

        port = free_port(PORT) if self.port is None else self.port
        check_server(port)
        shelf = open_shelf(self.source, self.against)
        if self.trial not in {"", *shelf.logs}:
            raise UsageError(
                f"there is no log of trial {self.trial!r} at {self.source}",
                fix=nearest(self.trial, list(shelf.logs)),
            )
        with ViewPage(shelf, self.trial, start=self.at, port=port) as page:
            stop = threading.Event()
            for number in (signal.SIGINT, signal.SIGTERM):
                # Said outright: a shell starts its background jobs with SIGINT ignored.
                signal.signal(number, lambda *_: stop.set())
            print(f"view: {self.source} is at {page.url}; Ctrl-C ends it", flush=True)
            if self.open:
                from nw_eval.cli.terminal.browser import show_address

                show_address(page.url)
            stop.wait()
        return 0
