"""Ledgers of verdicts: read, and reckoned up."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from nw_eval.gate.ledger.report import LedgerReport


def read_ledger(file: str | Path) -> LedgerReport:
    """Reckon up a ledger: gates a year, false alarms, re-rolls, and the best of many.

    Args:
        file: of the ledger.

    Raises:
        StoreError: it is missing or damaged.
    """
    from nw_eval.gate.ledger import file as ledger_file
    from nw_eval.gate.ledger.report import ledger_report

    contents = ledger_file.read_ledger(Path(file))
    return ledger_report(contents.entries, dropped=contents.dropped)
