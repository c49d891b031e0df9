"""Whether a candidate is worse than a baseline whose every trial is known: tests by betting."""

from __future__ import annotations

from nw_eval.stats.bank.decide import SUSPECT, Ruling, decide
from nw_eval.stats.bank.evidence import Evidence, Margins, Values, over_rounds
from nw_eval.stats.bank.interval import drop_interval
from nw_eval.stats.bank.order import order_of_starts
from nw_eval.stats.bank.panel import Bank

__all__ = [
    "SUSPECT",
    "Bank",
    "Evidence",
    "Margins",
    "Ruling",
    "Values",
    "decide",
    "drop_interval",
    "order_of_starts",
    "over_rounds",
]
