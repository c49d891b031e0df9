"""`nw-eval gate`: judge rows that exist."""

from __future__ import annotations

from pathlib import Path

from nw_eval.cli.verbs.options import Publishing
from nw_eval.cli.verbs.verb import Verb, verb_of


@verb_of("judge")
class GateRun(Publishing, Verb):
    """Judge the results of a run by its suite's bar and against a baseline; nothing is re-run."""

    run: Path
    ledger: Path | None = None
    """Append the verdict to this ledger (`nw-eval ledger` summarizes it)."""

    def __call__(self) -> int:
        from nw_eval import api

        with self.publishing(str(self.run)) as judged:
            judged.run = outcome = self.call()
            print(self.printed(outcome, outcome.exit_code))
            if self.ledger is not None:
                api.record_verdict(outcome, self.ledger)
            judged.code = outcome.exit_code
        return judged.code
