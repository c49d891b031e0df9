"""`nw-eval replay`: run a recorded trial again and compare it bit for bit, or show its log."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from nw_eval.words import Viewer


@dataclass(frozen=True, kw_only=True)
class Replay:
    """Run a recorded trial again from its log, and say whether it ends in the same bits.

    With --layout or --rrd its log is shown as it is, and nothing is run.
    """

    log: tyro.conf.Positional[Path]
    """A trial's MCAP file."""
    policy: Annotated[str | None, tyro.conf.arg(aliases=["-p"])] = None
    """The bundle that made it, when it has moved since."""
    checkpoint: Path | None = None
    """Weights to use in place of those that the card names."""
    start: float = 0.0
    """Restore the last recorded state at or before this second, instead of the beginning."""
    picture: Path | None = None
    """Write the trial's contact sheet (third person and robot's eye) to this PNG."""
    layout: Viewer | None = None
    """Print a layout of the log to import in Foxglove or Lichtblick; for Rerun, write a blueprint
    beside the log (needs nw-eval[rerun]) and print the commands that use it."""
    out: Path | None = None
    """Where --layout writes instead: a .json, or for Rerun an .rbl."""
    rrd: Path | None = None
    """Write the log as a recording of Rerun, an .rrd (needs nw-eval[rerun])."""
    allow_code: bool = False
    """Let `python:` adapters import code."""

    def __call__(self) -> int:
        if self.layout is not None or self.rrd is not None or self.out is not None:
            return self._show()
        from nw_eval import api
        from nw_eval.cli.text.replay import replay_line
        from nw_eval.errors import StoreError

        replayed = api.replay(
            self.log,
            policy=self.policy,
            checkpoint=self.checkpoint,
            start=self.start,
            picture=self.picture,
            allow_code=self.allow_code,
        )
        print(replay_line(replayed))
        if replayed.picture is not None:
            print(replayed.picture)
        return 0 if replayed.is_identical else StoreError.exit_code

    def _show(self) -> int:
        import json

        from nw_eval import api
        from nw_eval.cli.text.viewing import layout_lines, recording_line

        self._check_shown()
        if self.layout == "foxglove":
            layout = api.foxglove_layout(self.log, self.out)
            print(json.dumps(layout, indent=2) if self.out is None else self.out)
        elif self.layout == "rerun":
            out = self.out or self.log.with_suffix(".rbl")
            print(layout_lines(self.log, api.rerun_layout(self.log, out)))
        if self.rrd is not None:
            print(recording_line(api.rerun_recording(self.log, self.rrd)))
        return 0

    def _check_shown(self) -> None:
        from nw_eval.errors import UsageError

        if self.layout is None and self.out is not None:
            raise UsageError("--out is where --layout writes", fix="add --layout foxglove or rerun")
        run = {
            "--policy": self.policy,
            "--checkpoint": self.checkpoint,
            "--start": self.start or None,
            "--picture": self.picture,
            "--allow-code": self.allow_code or None,
        }
        used = [option for option, value in run.items() if value is not None]
        if used:
            shows = "--layout" if self.layout is not None else "--rrd"
            raise UsageError(
                f"{used[0]} is for running the trial again, {shows} runs nothing",
                fix="give them in two commands",
            )
