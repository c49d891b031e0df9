"""`nw-eval watch`: evaluate the checkpoints of a training as they appear."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, cast

import tyro

from nw_base.plural import plural
from nw_eval.cli.verbs.options import AllowCode, NoCache, Scenes, Workers

if TYPE_CHECKING:
    from nw_base.words import Tracker
    from nw_eval.api.watching import WatchedCheckpoint


@dataclass(frozen=True, kw_only=True)
class Watch:
    """Evaluate each new checkpoint of a training, the latest first, and gate it against the best.

    All meet the same trials. Their runs, a table (`watch.parquet`) and a page with success over
    training steps (`index.html`) are written to --out after each; the same command goes on there.
    The exit code is that of the verdict on the newest checkpoint.
    """

    leaves_verdict: ClassVar = True  # In a file, whatever becomes of the print.

    folder: tyro.conf.Positional[Path]
    """The folder that a training writes to. Its checkpoints are files below it with a number in
    their name, or in their folder's: `model_1500.pt`."""
    suite: str
    """A suite file, or the name of a shipped suite."""
    policy: Annotated[str | None, tyro.conf.arg(aliases=["-p"])] = None
    """Whose card the weights are for: a bundle's name or folder, or a card; the suite's own policy
    when absent."""
    pattern: str = "*"
    """Only files whose names match this glob."""
    every: int = 1
    """Evaluate each n-th step, from the first."""
    once: bool = False
    """End when all checkpoints that are there have been evaluated."""
    idle: float | None = None
    """End when for so many seconds no new one has appeared; Ctrl-C ends it when absent."""
    interval: float = 5.0
    """Seconds between two looks. A file is taken when two looks find it unchanged."""
    scenes: Scenes = None
    trials: Annotated[int | None, tyro.conf.arg(aliases=["-n"])] = None
    """Trials per scene of each checkpoint; the suite's own number when absent."""
    allow_code: AllowCode = False
    track: Annotated[
        tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="TRACKER[,TRACKER]")
    ] = ()
    """Show scores by training step in a tracker: wandb, mlflow, tensorboard."""
    out: Path | None = None
    """The folder of runs, table and page; `reports/watch-<suite>-<folder>` when absent."""
    workers: Workers = None
    no_cache: NoCache = False

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.terminal.last_words import tell
        from nw_eval.cli.terminal.progress import RunProgress

        words = [word.strip() for word in ",".join(self.track).split(",") if word.strip()]
        track = cast("tuple[Tracker, ...]", tuple(dict.fromkeys(words)))
        with RunProgress() as progress:
            watched = api.watch(
                self.folder,
                suite=self.suite,
                policy=self.policy,
                pattern=self.pattern,
                every=self.every,
                once=self.once,
                idle=self.idle,
                interval=self.interval,
                scenes=self.scenes,
                trials=self.trials,
                allow_code=self.allow_code,
                out=self.out,
                workers=self.workers,
                cache=not self.no_cache,
                where=api.Surfaces(track=track),
                listener=progress,
                progress=lambda made: progress.message(checkpoint_line(made)),
            )
        for each in watched.checkpoints:
            print(checkpoint_line(each))
        best = "none has a result" if watched.best is None else f"best: {watched.best.name}"
        print(f"{plural(len(watched.checkpoints), 'checkpoint')}; {best}; page: {watched.page}")
        if watched.interrupted:
            tell("interrupted; the same command goes on")
        return watched.exit_code


def checkpoint_line(made: WatchedCheckpoint) -> str:
    """Return what became of a checkpoint, in a line."""
    if made.problem:
        return f"step {made.step}: {made.name} cannot be used: {made.problem}"
    score = "" if made.success is None else f" · success {made.success:.3f}"
    fell = ""
    if made.drop is not None:
        fell = f" · drop {made.drop:.3f} against step {made.against}"
        if 0 < made.drop_trials < made.trials:
            fell += f" in the {made.drop_trials} trials that settled it"
    return (
        f"step {made.step}: {made.verdict}{score}{fell} · "
        f"completed {made.completed} of {plural(made.trials, 'trial')}"
    )
