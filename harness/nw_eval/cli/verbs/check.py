"""`nw-eval check`: what would run, without running it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True, kw_only=True)
class Check:
    """Say what a suite would run: scenes, trials, digests, expected minutes. Runs no physics.

    Tells everything that is wrong with the suite, its scenes and its policy at once (exit code 2).
    """

    suite: tyro.conf.Positional[str]
    """A suite file, or the name of a shipped suite (`nw-eval suites` lists them)."""
    robot: str | None = None
    """go1 or go2; the suite's own when absent."""
    policy: Annotated[str | None, tyro.conf.arg(aliases=["-p"])] = None
    """A shipped bundle's name, a bundle's folder, or a card; the suite's own when absent."""
    checkpoint: Path | None = None
    """Weights to use in place of those that the card names."""
    trials: Annotated[int | None, tyro.conf.arg(aliases=["-n"])] = None
    """Trials per scene; the suite's own number when absent."""
    scenes: tuple[str, ...] = ()
    """Only scenes that match one of these globs."""
    seed: int | None = None
    """Another panel of starts than the suite's own."""
    workers: Annotated[int | None, tyro.conf.arg(aliases=["-j"])] = None
    """Worker processes to reckon with; the number of cores when absent."""
    allow_code: bool = False
    """Let the policy's card import Python code."""
    collision: Literal["terrain", "triangles"] = "terrain"
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
            seed=self.seed,
            workers=self.workers,
            allow_code=self.allow_code,
            collision=self.collision,
        )
        print(told.text)
        return told.exit_code
