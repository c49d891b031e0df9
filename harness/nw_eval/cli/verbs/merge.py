"""`nw-eval merge`: the parts of a run become the run."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from nw_eval.cli.verbs.options import Publishing
from nw_eval.cli.verbs.verb import Verb, verb_of


@verb_of("merge")
class MergeRuns(Publishing, Verb):
    """Merge the shards of a run (`run --shard`) into one folder and print a verdict.

    Nothing is re-run. A missing shard or trial, two different results of one trial, or shards of
    different runs are errors.
    """

    leaves_verdict: ClassVar = True  # In a file, whatever becomes of the print.

    runs: tuple[Path, ...]
    out: Path
    ledger: Path | None = None
    """Append the verdict to this ledger (`nw-eval ledger` summarizes it)."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.api.ledgers import check_ledger

        with self.publishing(str(self.out)) as judged:
            if self.ledger is not None:
                check_ledger(self.ledger)
            judged.run = outcome = self.call()
            print(self.printed(outcome, outcome.exit_code))
            if self.ledger is not None:
                api.record_verdict(outcome, self.ledger)
            judged.code = outcome.exit_code
        return judged.code
