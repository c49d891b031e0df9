from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

from nw_gate.ledger import BaselineEntry, LedgerEntry, SeenScene

FIRST = datetime(2026, 11, 1, 9, tzinfo=UTC)


@pytest.fixture
def make_entry():
    """A verdict on four scenes of ten trials, against a baseline unless that is None."""

    def make(*, days: float = 0.0, checkpoint: int = 0, **changes: Any) -> LedgerEntry:
        baseline = BaselineEntry(
            bank="go1-parkour",
            digest="bb" * 32,
            basis="panel",
            word="PASS",
            rounds=10,
            drop=0.01,
            max_drop=0.1,
            tolerate=0.02,
            alpha_pass=0.05,
            alpha_regr=0.01,
        )
        facts: dict[str, Any] = {
            "time": FIRST + timedelta(days=days),
            "run": f"run-{days}",
            "suite": "hurdles",
            "suite_digest": "aa" * 32,
            "panel": "pinned",
            "candidate": f"step-{checkpoint}",
            "candidate_digest": f"{checkpoint:064x}",
            "word": "PASS",
            "trials": 40,
            "success": 0.9,
            "bar": None,
            "confidence": 0.95,
            "seen": (SeenScene(counts=(1, 0, 0, 0, 9)),) * 4,
            "baseline": baseline,
        }
        return LedgerEntry(**{**facts, **changes})

    return make
