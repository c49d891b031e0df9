"""Intervals as this room gives them, and the classics: how sure a share is, and how different two.

Of trials that did a thing or did not, such as reaching the end, and of paired differences.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb, cos, pi, sin, sqrt, tan
from statistics import NormalDist
from typing import NamedTuple

import numpy as np


class Interval(NamedTuple):
    """A confidence interval, both ends within the range of what it speaks of."""

    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """A mean with its interval and the number of observations behind it."""

    mean: float
    interval: Interval
    n: int
    confidence: float


def check_confidence(confidence: float) -> None:
    """Raise ValueError for a confidence that is no probability, such as 95."""
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence {confidence} is not between 0 and 1; write 0.95 for 95 %")


def wilson(successes: float, n: int, confidence: float = 0.95) -> Interval:
    """Return Wilson's two-sided score interval for a proportion.

    It stays within [0, 1], never has zero width, and its mean coverage is close to nominal at any
    `n`, though single proportions near 0 or 1 can fall a few points short; for display, not for
    verdicts. Without observations it is [0, 1]. `successes` may be a sum of shares within [0, 1]:
    these spread less than successes and failures do, so that the interval is rather too wide.

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


def newcombe(
    first: tuple[float, int], second: tuple[float, int], confidence: float = 0.95
) -> Interval:
    """Return Newcombe's hybrid score interval for the second share less the first.

    It is made of the two Wilson intervals, stays within [-1, 1] and covers close to nominally also
    where a share is 0 or 1; for display, as they are. Without observations on a side, that side's
    share is anything: the interval is then as wide as the other side leaves it.

    Args:
        first: successes and trials of one sample of independent trials.
        second: successes and trials of the other sample.
        confidence: two-sided.

    Source: R. G. Newcombe, "Interval estimation for the difference between independent proportions:
    comparison of eleven methods", Statist. Med. 17 (1998) 873-890, method 10.

    Raises:
        ValueError: counts or confidence are impossible.
    """
    one, two = wilson(*first, confidence), wilson(*second, confidence)
    if not first[1] or not second[1]:
        return Interval(two.low - one.high, two.high - one.low)
    a, b = first[0] / first[1], second[0] / second[1]
    return Interval(
        b - a - sqrt((one.high - a) ** 2 + (b - two.low) ** 2),
        b - a + sqrt((a - one.low) ** 2 + (two.high - b) ** 2),
    )


def fisher(*strata: tuple[tuple[int, int], tuple[int, int]]) -> float:
    """Return the two-sided p-value of Fisher's exact test that two shares are equal.

    Where there are several strata, such as scenes, the shares are equal within each and may differ
    between them; what is looked at is the sum of the first's successes. The p-value is the sum,
    over all tables with these totals, of the probabilities of those that are no likelier than what
    was seen.

    Args:
        *strata: for each, successes and trials of the first, and of the second; trials independent.

    Source: R. A. Fisher, "The logic of inductive inference", J. Roy. Statist. Soc. 98 (1935); with
    strata J. J. Gart, "Point and interval estimation of the common odds ratio in the combination of
    2 x 2 tables with fixed marginals", Biometrika 57 (1970).

    Raises:
        ValueError: counts are impossible.
    """
    likelihood, seen = np.ones(1), 0
    for (successes, n), (others, m) in strata:
        if not (0 <= successes <= n and 0 <= others <= m):
            raise ValueError(f"{successes} successes of {n}, {others} of {m}")
        total = successes + others
        least, most = max(0, total - m), min(n, total)
        ways = [comb(n, one) * comb(m, total - one) for one in range(least, most + 1)]
        likelihood = np.convolve(likelihood, [way / comb(n + m, total) for way in ways])
        seen += successes - least
    # Equally likely tables may differ by rounding.
    return min(1.0, float(likelihood[likelihood <= likelihood[seen] * (1.0 + 1e-9)].sum()))


_STEPS = 60  # Halvings of a right angle: beyond the precision of a double.


def t_quantile(confidence: float, freedom: int) -> float:
    """Return t such that |T| <= t with this probability.

    The probability has a finite series in the angle atan(t / sqrt(freedom)), by which it is halved.

    Args:
        confidence: within (0, 1).
        freedom: degrees of freedom, at least 1.

    Source: M. Abramowitz and I. A. Stegun, Handbook of Mathematical Functions (1964), 26.7.3 and 4.
    """
    low, high = 0.0, pi / 2
    for _ in range(_STEPS):
        middle = (low + high) / 2
        low, high = (middle, high) if _within(middle, freedom) < confidence else (low, middle)
    return sqrt(freedom) * tan(low)


def _within(angle: float, freedom: int) -> float:
    """Return the probability of |T| <= sqrt(freedom) tan(angle)."""
    odd = freedom % 2
    term = cos(angle) if odd else 1.0
    total = 0.0
    for k in range(1 + odd, freedom, 2):
        total += term
        term *= cos(angle) ** 2 * k / (k + 1)
    return 2.0 / pi * (angle + sin(angle) * total) if odd else sin(angle) * total
