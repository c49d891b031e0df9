"""`nw-eval check`: what would run, without running it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro


@dataclass(frozen=True, kw_only=True)
class Check:
    """Say what a suite would run: scenes, trials, digests, expected minutes. Runs no physics."""

    suite: tyro.conf.Positional[str]
    """A suite file, or the name of a shipped suite."""
    robot: str | None = None
    """go1 or go2; the suite's own when absent."""
    policy: str | None = None
    """A shipped bundle's name, a bundle's folder, or a card; the suite's own when absent."""
    checkpoint: Path | None = None
    """Weights to use with the card, when they lie elsewhere than it says."""
    trials: int | None = None
    """Trials per scene; the suite's own number when absent."""
    scenes: tuple[str, ...] = ()
    """Only scenes that match one of these globs."""
    workers: int | None = None
    """Worker processes to reckon with; the number of cores when absent."""
    allow_code: bool = False
    """Let the policy's card import Python code."""
    collision: Literal["terrain", "flex"] = "terrain"
    """How scan meshes collide: compiled to terrain, or slow and exact by their own triangles."""

    def __call__(self) -> int:
        from nw_eval import api

        told = api.check(
            self.suite,
            robot=self.robot,
            policy=self.policy,
            checkpoint=self.checkpoint,
            trials=self.trials,
            scenes=self.scenes,
            workers=self.workers,
            allow_code=self.allow_code,
            collision=self.collision,
        )
        print(told.text)
        return told.exit_code
