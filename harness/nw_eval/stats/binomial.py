"""Intervals for the share of trials that did a thing, such as reaching the last waypoint."""

from __future__ import annotations

from math import sqrt
from statistics import NormalDist

from nw_eval.stats.interval import Interval, check_confidence


def wilson(successes: int, n: int, confidence: float = 0.95) -> Interval:
    """Return Wilson's two-sided score interval for a proportion.

    It stays within [0, 1], never has zero width, and its mean coverage is close to nominal at any
    `n`, though single proportions near 0 or 1 can fall a few points short; for display, not for
    verdicts. Without observations it is [0, 1].

    Source: E. B. Wilson, "Probable inference, the law of succession, and statistical inference",
    JASA 22 (1927); recommended for small n by Brown, Cai and DasGupta, Statist. Sci. 16 (2001).

    Raises:
        ValueError: counts or confidence are impossible.
    """
    check_confidence(confidence)
    if not 0 <= successes <= n:
        raise ValueError(f"{successes} successes of {n}")
    if n == 0:
        return Interval(0.0, 1.0)
    z = NormalDist().inv_cdf(0.5 + confidence / 2)
    share = successes / n
    centre = (share + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    # The ends are 0 and 1 exactly where nothing or everything succeeded; rounding would miss them.
    low = 0.0 if successes == 0 else max(0.0, centre - half)
    high = 1.0 if successes == n else min(1.0, centre + half)
    return Interval(low, high)
