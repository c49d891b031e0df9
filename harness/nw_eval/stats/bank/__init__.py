"""Whether a candidate is worse than a baseline whose every trial is known: tests by betting."""

from __future__ import annotations

from nw_eval.stats.bank.curve import (
    CurvePoint,
    Progress,
    operating_curve,
    progress_at,
    trials_for,
)
from nw_eval.stats.bank.decide import SUSPECT, Ruling, decide, most_false_alarms
from nw_eval.stats.bank.evidence import Evidence, Margins, Values, over_rounds
from nw_eval.stats.bank.interval import drop_interval_after, scene_drop_intervals
from nw_eval.stats.bank.order import order_of_starts, order_of_trials
from nw_eval.stats.bank.outlook import progress_from
from nw_eval.stats.bank.panel import Bank
from nw_eval.stats.bank.simulate import Against
from nw_eval.stats.bank.trials import (
    CRITICAL_TRIALS,
    DrawnTrials,
    Looks,
    TrialRules,
    TrialRuling,
    looks,
    settle,
    settle_all,
)

__all__ = [
    "CRITICAL_TRIALS",
    "SUSPECT",
    "Against",
    "Bank",
    "CurvePoint",
    "DrawnTrials",
    "Evidence",
    "Looks",
    "Margins",
    "Progress",
    "Ruling",
    "TrialRules",
    "TrialRuling",
    "Values",
    "decide",
    "drop_interval_after",
    "looks",
    "most_false_alarms",
    "operating_curve",
    "order_of_starts",
    "order_of_trials",
    "over_rounds",
    "progress_at",
    "progress_from",
    "scene_drop_intervals",
    "settle",
    "settle_all",
    "trials_for",
]
