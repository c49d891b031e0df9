"""`nw-eval gate`: judge rows that exist."""

from __future__ import annotations

from pathlib import Path

from nw_eval.cli.verbs.options import Publishing
from nw_eval.cli.verbs.verb import Verb, verb_of


@verb_of("judge")
class GateRun(Publishing, Verb):
    """Judge a run's rows by its suite's bar and against a baseline, without running anything."""

    run: Path
    ledger: Path | None = None
    """Add the verdict to this ledger of verdicts (`nw-eval ledger` sums it up)."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.verbs.options import summary

        with self.publishing(str(self.run)) as judged:
            judged.run = outcome = self.call()
            print(summary(outcome, folded=self.on_github))
            if self.ledger is not None:
                api.record_verdict(outcome, self.ledger)
            judged.code = outcome.exit_code
        return judged.code
