"""`nw-eval ledger`: what many verdicts are worth together."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro


@dataclass(frozen=True, kw_only=True)
class Ledger:
    """Sum up a ledger: gates a year, false alarms, re-rolls, and luck of the best of many."""

    file: tyro.conf.Positional[Path]
    """The ledger."""
    head: str | None = None
    """The head that an earlier call printed, kept elsewhere. A ledger without that line is refused:
    its end was cut off, or it was written anew."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.text.judging.ledger import ledger_page

        print(ledger_page(api.read_ledger(self.file, head=self.head)))
        return 0
