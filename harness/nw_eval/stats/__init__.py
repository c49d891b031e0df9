"""Pure functions on arrays: numbers in, small frozen results out. Knows no suites and no rows."""

from __future__ import annotations

from nw_eval.stats.betting import (
    Groups,
    evidence_above,
    lower_bound,
    trials_to_certify,
    upper_bound,
)
from nw_eval.stats.binomial import wilson
from nw_eval.stats.bootstrap import mean_of_scenes
from nw_eval.stats.courses import SceneCounts
from nw_eval.stats.foresight import Shares, shares_after, shares_at
from nw_eval.stats.interval import Estimate, Interval

__all__ = [
    "Estimate",
    "Groups",
    "Interval",
    "SceneCounts",
    "Shares",
    "evidence_above",
    "lower_bound",
    "mean_of_scenes",
    "shares_after",
    "shares_at",
    "trials_to_certify",
    "upper_bound",
    "wilson",
]
