from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nw_gate.stats.interval import wilson


@pytest.mark.parametrize(
    ("successes", "n", "low", "high"),
    [
        # R. G. Newcombe, "Two-sided confidence intervals for the single proportion", Statistics in
        # Medicine 17 (1998), table I, method 3 (score interval without continuity correction).
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0000, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_wilson_agrees_with_the_published_table(successes, n, low, high):
    interval = wilson(successes, n)
    assert interval.low == pytest.approx(low, abs=5e-5)
    assert interval.high == pytest.approx(high, abs=5e-5)


def test_nothing_is_known_without_trials():
    assert wilson(0, 0) == (0.0, 1.0)


@pytest.mark.parametrize(("successes", "n"), [(3, 2), (-1, 4)])
def test_impossible_counts_are_refused(successes, n):
    with pytest.raises(ValueError, match="successes of"):
        wilson(successes, n)


@pytest.mark.parametrize("confidence", [0.0, 1.0, 95.0, -1.0, float("nan")])
def test_a_confidence_that_is_no_probability_is_refused(confidence):
    with pytest.raises(ValueError, match=r"write 0\.95 for 95 %"):
        wilson(1, 2, confidence)


@given(st.integers(1, 400), st.data(), st.floats(0.5, 0.999))
def test_the_interval_holds_the_share_and_mirrors_for_failures(n, data, confidence):
    k = data.draw(st.integers(0, n))
    interval = wilson(k, n, confidence)
    assert 0.0 <= interval.low <= k / n <= interval.high <= 1.0
    assert interval.low < interval.high
    mirrored = wilson(n - k, n, confidence)
    assert mirrored.low == pytest.approx(1.0 - interval.high, abs=1e-12)


@given(st.integers(1, 200), st.data())
def test_more_confidence_is_a_wider_interval(n, data):
    k = data.draw(st.integers(0, n))
    narrow, wide = wilson(k, n, 0.8), wilson(k, n, 0.99)
    assert wide.low <= narrow.low
    assert narrow.high <= wide.high


def test_coverage_averaged_over_proportions_is_nominal():
    # Brown, Cai and DasGupta (2001), section 4: mean coverage of the score interval is close to
    # nominal even at n = 10. Exact sums over the binomial distribution, no simulation.
    from math import comb

    shares = np.linspace(0.005, 0.995, 199)
    for n in (10, 30):
        intervals = [wilson(k, n) for k in range(n + 1)]
        covered = [
            sum(
                comb(n, k) * p**k * (1 - p) ** (n - k)
                for k in range(n + 1)
                if intervals[k].low <= p <= intervals[k].high
            )
            for p in shares
        ]
        assert np.mean(covered) == pytest.approx(0.95, abs=0.01)
