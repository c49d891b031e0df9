"""`nw-eval plan`: how many trials a gate against a baseline takes, and what it sees."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True, kw_only=True)
class PlanTrials:
    """Say how many trials convict a drop against a baseline, and what else the gate would see.

    Simulates the gate from the scores of a bank, or of a run of the suite. Runs no physics. `check`
    says what would run; this one what it would show.
    """

    suite: tyro.conf.Positional[str]
    """A suite file, or the name of a shipped suite (`nw-eval suites` lists them)."""
    detect: float | None = None
    """Drop of mean success to convict; the suite's gate.max_drop when absent."""
    baseline: str | None = None
    """The bank to compare with, by name or path; when absent the suite's gate.baseline, or the only
    one that there is of the suite."""
    run: Path | None = None
    """In place of a bank, a run of the suite: its scores are taken for the baseline's."""
    png: Path | None = None
    """Draw the curve into this file."""
    workers: Annotated[int | None, tyro.conf.arg(aliases=["-j"])] = None
    """Worker processes to reckon minutes with; the number of cores when absent."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.text.judging.trial_plan import trial_plan_page

        planned = api.plan_trials(
            self.suite,
            detect=self.detect,
            baseline=self.baseline,
            run=self.run,
            png=self.png,
            workers=self.workers,
        )
        print(trial_plan_page(planned))
        if self.png is not None:
            print(f"drawn in {self.png}")
        return 0
