"""Whether a candidate is worse than a baseline whose every trial is known: tests by betting."""

from __future__ import annotations

from nw_eval.stats.bank.curve import (
    CurvePoint,
    Progress,
    operating_curve,
    progress_at,
    rounds_for,
)
from nw_eval.stats.bank.decide import SUSPECT, Ruling, decide
from nw_eval.stats.bank.evidence import Evidence, Margins, Values, over_rounds
from nw_eval.stats.bank.interval import drop_interval, scene_drop_intervals
from nw_eval.stats.bank.order import order_of_starts
from nw_eval.stats.bank.outlook import progress_after
from nw_eval.stats.bank.panel import Bank
from nw_eval.stats.bank.simulate import GateRules

__all__ = [
    "SUSPECT",
    "Bank",
    "CurvePoint",
    "Evidence",
    "GateRules",
    "Margins",
    "Progress",
    "Ruling",
    "Values",
    "decide",
    "drop_interval",
    "operating_curve",
    "order_of_starts",
    "over_rounds",
    "progress_after",
    "progress_at",
    "rounds_for",
    "scene_drop_intervals",
]
