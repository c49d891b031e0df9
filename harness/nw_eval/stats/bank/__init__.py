"""Whether a candidate is worse than a baseline whose every trial is known: tests by betting."""

from __future__ import annotations

from nw_eval.stats.bank.curve import (
    CurvePoint,
    Progress,
    operating_curve,
    progress_at,
    trials_for,
)
from nw_eval.stats.bank.evidence import Margins
from nw_eval.stats.bank.interval import drop_interval_after, scene_drop_intervals
from nw_eval.stats.bank.order import order_of_starts, order_of_trials
from nw_eval.stats.bank.outlook import progress_from
from nw_eval.stats.bank.panel import Bank
from nw_eval.stats.bank.simulate import Against
from nw_eval.stats.bank.trials import (
    CRITICAL_TRIALS,
    SUSPECT,
    DrawnTrials,
    Looks,
    TrialRules,
    TrialRuling,
    looks,
    most_false_alarms,
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
    "Looks",
    "Margins",
    "Progress",
    "TrialRules",
    "TrialRuling",
    "drop_interval_after",
    "looks",
    "most_false_alarms",
    "operating_curve",
    "order_of_starts",
    "order_of_trials",
    "progress_at",
    "progress_from",
    "scene_drop_intervals",
    "settle",
    "settle_all",
    "trials_for",
]
