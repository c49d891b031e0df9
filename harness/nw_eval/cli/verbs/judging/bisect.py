"""`nw-eval bisect`: which checkpoint of a series is flagged first."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True, kw_only=True)
class BisectSeries:
    """Find the first checkpoint of a series that the gate flags as worse than a good one.

    Checkpoints are files of weights for the card of --policy, or bundles, in order of age. Each
    that is asked for is judged against the baseline of the good one, as `run --baseline` does, but
    for the suite's bar. One before the first flagged may already be worse by less than the gate
    sees: the result says by how much at most. Exit code 1 if one was flagged, 0 if the bad one was
    not, 3 if nothing was decided.
    """

    suite: tyro.conf.Positional[str]
    """A suite file, or the name of a shipped suite."""
    checkpoints: tyro.conf.Positional[tuple[str, ...]]
    """The series between the good and the bad one."""
    good: str
    """A baseline, or the checkpoint before the series, of which a baseline is saved first."""
    bad: str
    """The checkpoint after the series."""
    policy: Annotated[str | None, tyro.conf.arg(aliases=["-p"])] = None
    """Whose card the weights are for; the suite's own policy when absent."""
    everyone: bool = False
    """Judge every checkpoint: searching alone seldom sees that a series is not monotone."""
    scenes: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="[GLOB [GLOB ...]]")] = None
    """Only scenes that match one of these globs, or are of `split:train` or `split:eval`."""
    trials: Annotated[int | None, tyro.conf.arg(aliases=["-n"])] = None
    """The most trials of each scene for each checkpoint, on average; `gate.rounds` of the suite
    when absent."""
    starts: int | None = None
    """Starts in each scene of a baseline that is saved; 60 when absent."""
    allow_code: bool = False
    """Let the policy's card import Python code."""
    out: Path | None = None
    """The folder of the runs, in which an interrupted search goes on; `reports/bisect-<suite>`
    when absent."""
    workers: Annotated[int | None, tyro.conf.arg(aliases=["-j"])] = None
    """Worker processes; the number of cores when absent."""
    no_cache: bool = False
    """Run every trial, and keep no result for later runs."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.terminal.last_words import tell
        from nw_eval.cli.terminal.progress import RunProgress
        from nw_eval.cli.text.judging.series import series_page

        with RunProgress() as progress:
            series = api.bisect(
                self.suite,
                self.checkpoints,
                good=self.good,
                bad=self.bad,
                policy=self.policy,
                everyone=self.everyone,
                scenes=self.scenes,
                trials=self.trials,
                starts=self.starts,
                allow_code=self.allow_code,
                out=self.out,
                workers=self.workers,
                cache=not self.no_cache,
                listener=progress,
                progress=lambda name, word: progress.message(f"{name}: {word}"),
            )
        print(series_page(series))
        if series.found is None:
            tell("interrupted; the same command goes on")
        return series.exit_code
