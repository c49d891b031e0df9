"""`nw-eval plan`: how many trials a gate takes and what it sees; or into which parts they go."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True, kw_only=True)
class PlanTrials:
    """Say how many trials detect a drop against a baseline, and what else the gate would see.

    Simulates the gate from the scores of a baseline, or of a run of the suite. Of a suite with a
    bar and no baseline it says how many trials the bar needs, and who passes. Runs no physics.
    `check` says what would run; this one what it would show. With --shards it says instead into
    which parts a run goes, each of which a machine of its own runs (`run --shard`).
    """

    suite: tyro.conf.Positional[str]
    """A suite file, or the name of a shipped suite (`nw-eval suites` lists them)."""
    detect: float | None = None
    """Drop of mean success to detect; the suite's gate.max_drop when absent."""
    baseline: str | None = None
    """The baseline to compare with, by name or path; when absent the suite's gate.baseline, or the
    only one that there is of the suite."""
    run: Path | None = None
    """In place of a baseline, a run of the suite: its scores are taken for the baseline's."""
    png: Path | None = None
    """Draw the curve into this file."""
    workers: Annotated[int | None, tyro.conf.arg(aliases=["-j"])] = None
    """Worker processes to estimate minutes with; the number of cores when absent."""

    shards: int | None = None
    """Cut a run into so many parts."""
    json: bool = False
    """With --shards: print them as the JSON of a GitHub matrix, in one line."""
    policy: Annotated[str | None, tyro.conf.arg(aliases=["-p"])] = None
    """With --shards: as for `run`, and so are the next two."""
    trials: Annotated[int | None, tyro.conf.arg(aliases=["-n"])] = None
    """Trials per scene, against a baseline at most."""
    scenes: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="[GLOB [GLOB ...]]")] = None
    """Only scenes that match one of these globs, or are of `split:train` or `split:eval`."""

    def __call__(self) -> int:
        self._check()
        return self._foresee() if self.shards is None else self._cut(self.shards)

    def _check(self) -> None:
        """Refuse options that say nothing about what is asked.

        Raises:
            UsageError: naming one.
        """
        from nw_eval.errors import UsageError

        of_parts = ("json", "policy", "trials", "scenes")
        of_curve = ("detect", "run", "png")
        for name in of_parts if self.shards is None else of_curve:
            if getattr(self, name) not in {None, False}:
                without = "without" if self.shards is None else "with"
                raise UsageError(f"--{name} {without} --shards", fix=f"drop --{name}")

    def _cut(self, shards: int) -> int:
        from nw_eval import api
        from nw_eval.cli.text.judging.shard_plan import shard_matrix, shard_page

        planned = api.plan_shards(
            self.suite,
            shards,
            workers=self.workers,
            policy=self.policy,
            baseline=self.baseline,
            trials=self.trials,
            scenes=self.scenes,
        )
        print(shard_matrix(planned) if self.json else shard_page(planned))
        return 0

    def _foresee(self) -> int:
        from nw_eval import api
        from nw_eval.cli.text.judging.trial_plan import bar_plan_page, trial_plan_page

        planned = api.plan_trials(
            self.suite,
            detect=self.detect,
            baseline=self.baseline,
            run=self.run,
            png=self.png,
            workers=self.workers,
        )
        if isinstance(planned, api.BarPlan):
            print(bar_plan_page(planned))
            return 0
        print(trial_plan_page(planned))
        if self.png is not None:
            print(f"drawn in {self.png}")
        return 0
