"""`nw-eval report`: write a run's pages again, from its rows."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import tyro

from nw_eval.cli.verbs.publishing import Publishing

if TYPE_CHECKING:
    from nw_eval.api import RunReport


@dataclass(frozen=True, kw_only=True)
class Report(Publishing):
    """Judge a finished or interrupted run again from its rows, and write its report."""

    leaves_verdict: ClassVar = True  # In a file, whatever becomes of the print.

    run: tyro.conf.Positional[Path]
    """A run's folder."""
    out: Path | None = None
    """Where to write the Markdown; the run's own report.md when absent."""

    def __call__(self) -> int:
        return self.publishing(str(self.run), self._judge)

    def _judge(self) -> tuple[RunReport, int]:
        from nw_eval import api
        from nw_eval.cli.terminal.summary import summary

        outcome = api.report(self.run, out=self.out)
        print(summary(outcome, folded=self.on_github))
        return outcome, outcome.exit_code
