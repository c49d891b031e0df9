"""Quantiles of Student's t distribution."""

from __future__ import annotations

from math import cos, pi, sin, sqrt, tan

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
