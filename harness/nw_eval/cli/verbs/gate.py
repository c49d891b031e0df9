"""`nw-eval gate`: judge rows that exist."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from nw_eval.cli.verbs.options import Publishing


@dataclass(frozen=True, kw_only=True)
class GateRun(Publishing):
    """Judge a run's rows by its suite's bar and against a baseline, without running anything."""

    run: tyro.conf.Positional[Path]
    """A run's folder."""
    baseline: str | None = None
    """The baseline to compare with: its name, its file, or none; when absent that which the run
    was begun against, or else the one that its suite names for its own policy."""
    max_drop: float | None = None
    """Drop of mean success against the baseline that must not pass; the suite's own when absent."""
    tolerate: float | None = None
    """Drop against the baseline that must not be REGRESSED; the suite's own when absent."""
    out: Path | None = None
    """Where to write the report in Markdown, with a page in HTML beside it; nowhere when absent."""
    ledger: Path | None = None
    """Add the verdict to this ledger of verdicts (`nw-eval ledger` sums it up)."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.verbs.options import summary

        with self.publishing(str(self.run)) as judged:
            judged.run = outcome = api.judge(
                self.run,
                baseline=self.baseline,
                max_drop=self.max_drop,
                tolerate=self.tolerate,
                out=self.out,
            )
            print(summary(outcome, folded=self.on_github))
            if self.ledger is not None:
                api.record_verdict(outcome, self.ledger)
            judged.code = outcome.exit_code
        return judged.code
