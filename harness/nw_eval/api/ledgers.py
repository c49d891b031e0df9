"""Ledgers of verdicts: reading and summaries."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from nw_eval.api.reports import RunReport
    from nw_gate.ledger_report import LedgerReport


def record_verdict(judged: RunReport, ledger: str | Path) -> Path:
    """Add the verdict on a run to a ledger, and wait until it is on disk.

    Args:
        judged: the run.
        ledger: the file, which is begun if there is none.

    Returns:
        The file.

    Raises:
        UsageError: the run is a part of one, and has no verdict.
        StoreError: the ledger is damaged, or cannot be written.
    """
    from nw_eval.api.saved_run import check_whole
    from nw_gate.ledger import append_verdict

    check_whole(judged.info)

    append_verdict(Path(ledger), judged.verdict, judged.info, judged.rows, baseline=judged.baseline)
    return Path(ledger)


def check_ledger(ledger: str | Path) -> None:
    """Check before a run that its verdict can be added to a ledger; nothing is written.

    Args:
        ledger: the file.

    Raises:
        UsageError: it cannot be written, or is damaged.
    """
    from nw_gate import ledger as ledgers

    ledgers.check_ledger(Path(ledger))


def read_ledger(file: str | Path, *, head: str | None = None) -> LedgerReport:
    """Summarise a ledger: gates a year, false alarms, re-rolls, and the best of many.

    Args:
        file: the ledger's file, which `run` or `gate` wrote.
        head: the head of an earlier report that you kept elsewhere. A ledger without that line was
            truncated or rewritten, and is an error.

    Raises:
        StoreError: it is missing or damaged, or its end was cut off.
    """
    from nw_gate import ledger
    from nw_gate.ledger_report import ledger_report

    contents = ledger.read_ledger(Path(file), head=head)
    return ledger_report(contents.entries, dropped=contents.dropped, head=contents.last_sum)
