"""`nw-eval merge`: the parts of a run become the run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import tyro

from nw_eval.cli.verbs.options import Publishing


@dataclass(frozen=True, kw_only=True)
class MergeRuns(Publishing):
    """Put the parts of a run (`run --shard`) together in one folder, and give a verdict of it.

    Runs nothing. A part or a trial that is missing, two different results of one trial, and parts
    of different runs are refused, by name.
    """

    leaves_verdict: ClassVar = True  # In a file, whatever becomes of the print.

    runs: tyro.conf.Positional[tuple[Path, ...]]
    """The folders of all parts, in any order."""
    out: Path
    """The folder of the merged run."""
    baseline: str | None = None
    """The baseline to compare with: its name, its file, or none; when absent that which the
    parts were begun against, or else the one that the suite names for its own policy."""
    ledger: Path | None = None
    """Add the verdict to this ledger of verdicts (`nw-eval ledger` sums it up)."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.api.ledgers import check_ledger
        from nw_eval.cli.verbs.options import summary

        with self.publishing(str(self.out)) as judged:
            if self.ledger is not None:
                check_ledger(self.ledger)
            judged.run = outcome = api.merge(self.runs, out=self.out, baseline=self.baseline)
            print(summary(outcome, folded=self.on_github))
            if self.ledger is not None:
                api.record_verdict(outcome, self.ledger)
            judged.code = outcome.exit_code
        return judged.code
