"""Pure functions on arrays: numbers in, small frozen results out. Knows no suites and no rows."""

from __future__ import annotations

from nw_eval.stats.betting import (
    Groups,
    evidence_above,
    lower_bound,
    repeats_to_decide,
    trials_to_certify,
    upper_bound,
)
from nw_eval.stats.binomial import wilson
from nw_eval.stats.bootstrap import mean_of_scenes
from nw_eval.stats.interval import Estimate, Interval

__all__ = [
    "Estimate",
    "Groups",
    "Interval",
    "evidence_above",
    "lower_bound",
    "mean_of_scenes",
    "repeats_to_decide",
    "trials_to_certify",
    "upper_bound",
    "wilson",
]
