"""`nw-eval view`: look at trials in the browser, or play with a policy in a scene."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from nw_eval.cli.terminal.interruption import stopped_by_signals
from nw_eval.cli.verbs.shared import AllowCode, Checkpoint

if TYPE_CHECKING:
    from nw_eval.view.drawing import ServedPage

_POLICY = "go1-parkour"
_PLACE = "hurdles/one_low_carpet"


@dataclass(frozen=True, kw_only=True)
class ViewTrials:
    """Open a trial or a live policy in the browser (Ctrl-C to stop).

    A log or a run is shown as recorded: play, step and scrub, jump to waypoints and to where two
    trials diverge. A scene or a policy runs live: push or load the robot, change friction, latency
    and light, move its goal, drop a box in its way, and save that as a suite.
    """

    source: tyro.conf.Positional[str | None] = None
    """A trial's log, a run folder, a scene or a policy. Optional with --policy or --scene."""
    baseline: Path | None = None
    """Another log or run folder. Its trials of the same names are shown as ghosts."""
    trial: str = ""
    """Trial of a run to show first, by its name in the report."""
    at: float = 0.0
    """Second of the trial to show first."""
    policy: Annotated[str | None, tyro.conf.arg(aliases=["-p"])] = None
    """Policy to run live (default: go1-parkour, if --scene is given)."""
    scene: str | None = None
    """Scene to run it in (default: hurdles/one_low_carpet, if --policy is given)."""
    checkpoint: Checkpoint = None
    allow_code: AllowCode = False
    port: int | None = None
    """Port on this machine's loopback address; 0 chooses a free one (default: 8720, the port that
    report links use, or any free port)."""
    open: bool = False
    """Open the page in this machine's browser."""

    def __call__(self) -> int:
        from nw_eval.view.sources import kind_of
        from nw_eval.viewing.browser import check_server, free_port
        from nw_gate.results.moment_link import PORT

        port = free_port(PORT) if self.port is None else self.port
        check_server(port)
        kind = kind_of(self.source, policy=self.policy, scene=self.scene)
        if kind == "log":
            return self._serve(self._logged(port), str(self.source))
        policy = self.policy or (self.source if kind == "policy" else None) or _POLICY
        scene = self.scene or (self.source if kind == "scene" else None) or _PLACE
        from nw_eval.view.live_page import open_live

        page = open_live(
            policy, scene, checkpoint=self.checkpoint, allow_code=self.allow_code, port=port
        )
        return self._serve(page, f"{policy} in {scene}")

    def _logged(self, port: int) -> AbstractContextManager[ServedPage]:
        from nw_base.errors import UsageError, nearest
        from nw_eval.view.sources import open_shelf
        from nw_eval.view.trials_page import ViewPage

        assert self.source is not None, "it was found to be a log"
        shelf = open_shelf(Path(self.source), self.baseline)
        if self.trial not in {"", *shelf.logs}:
            raise UsageError(
                f"there is no log of trial {self.trial!r} at {self.source}",
                fix=nearest(self.trial, list(shelf.logs)),
            )
        return ViewPage(shelf, self.trial, start=self.at, port=port)

    def _serve(self, opened: AbstractContextManager[ServedPage], what: str) -> int:
        with opened as page:
            stop = stopped_by_signals()
            print(f"view: {what} is at {page.url}; Ctrl-C ends it", flush=True)
            if self.open:
                from nw_eval.cli.terminal.final_output import show_address

                show_address(page.url)
            stop.wait()
        return 0
