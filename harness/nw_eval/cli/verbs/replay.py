"""`nw-eval replay`: run a recorded trial again and compare it bit for bit."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True, kw_only=True)
class Replay:
    """Run a recorded trial again from its log, and say whether it ends in the same bits."""

    log: tyro.conf.Positional[Path]
    """A trial's MCAP file."""
    policy: Annotated[str | None, tyro.conf.arg(aliases=["-p"])] = None
    """The bundle that made it, when it has moved since."""
    checkpoint: Path | None = None
    """Weights to use with the card, when they lie elsewhere than it says."""
    start: float = 0.0
    """Restore the last recorded state at or before this second, instead of the beginning."""
    picture: Path | None = None
    """Write the trial's contact sheet (third person and robot's eye) to this PNG."""
    allow_code: bool = False
    """Let `python:` adapters import code."""

    def __call__(self) -> int:
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
