"""`nw-eval run`: roll a checkpoint out through a suite, and judge it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import tyro


@dataclass(frozen=True, kw_only=True)
class Run:
    """Roll a checkpoint out through a suite, write the evidence, and give a verdict.

    A suite without a bar (`gate.success_rate`) is only run: its verdict is RAN, exit code 0.
    """

    leaves_verdict: ClassVar = True  # In a file, whatever becomes of the print.

    suite: tyro.conf.Positional[str | None] = None
    """A suite file, or the name of a shipped suite (`nw-eval suites` lists them); only --resume can
    do without."""
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
    """Another panel of starts than the suite's own: other trials in the same scenes."""
    workers: Annotated[int | None, tyro.conf.arg(aliases=["-j"])] = None
    """Worker processes; the number of cores when absent."""
    out: Path | None = None
    """The run's folder; `reports/<suite>-<policy>-<time>-<digest>` when absent."""
    resume: Path | None = None
    """The folder of an interrupted run to finish."""
    record: Literal["all", "failures", "none"] | None = None
    """Camera images in MCAP for which trials; the suite's own choice when absent."""
    time_limit: float | None = None
    """Seconds of wall time after which a trial counts as hung; a generous default when absent."""
    render: Literal["cpu", "cuda"] = "cpu"
    """The splat renderer. There is no silent fallback."""
    allow_code: bool = False
    """Let the policy's card import Python code."""
    collision: Literal["terrain", "triangles"] = "terrain"
    """How scan meshes collide: compiled to terrain, or slow and exact by their own triangles."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.terminal.interruption import INTERRUPTED
        from nw_eval.cli.terminal.last_words import tell
        from nw_eval.cli.terminal.progress import RunProgress

        with RunProgress() as progress:
            outcome = api.run(
                self.suite,
                robot=self.robot,
                policy=self.policy,
                checkpoint=self.checkpoint,
                trials=self.trials,
                scenes=self.scenes,
                seed=self.seed,
                workers=self.workers,
                out=self.out,
                resume=self.resume,
                record=self.record,
                time_limit=self.time_limit,
                render=self.render,
                allow_code=self.allow_code,
                collision=self.collision,
                listener=progress,
            )
        print(outcome.summary)
        # An interruption that left no trial missing has interrupted nothing.
        if outcome.interrupted and outcome.verdict.verdict == "INFRASTRUCTURE":
            tell(f"interrupted; continue with --resume {outcome.folder}")
            return INTERRUPTED
        return outcome.exit_code
