from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from nw_gate.stats.bootstrap import mean_of_scenes

unit = st.floats(0.0, 1.0)
groups = st.lists(arrays(np.float64, st.integers(1, 12), elements=unit), min_size=1, max_size=5)


def waypoints(rng: np.random.Generator, n: int, q: float, count: int = 5) -> np.ndarray:
    """Fractions of trials that pass each waypoint with probability q and end at the first miss."""
    return np.cumprod(rng.random((n, count)) < q, axis=1).sum(axis=1) / count


def true_mean(q: float, count: int = 5) -> float:
    return sum(q**k for k in range(1, count + 1)) / count


def test_scenes_weigh_equally_whatever_their_number_of_trials():
    found = mean_of_scenes([np.zeros(2), np.ones(30)])
    assert found.mean == 0.5
    assert found.n == 32


def test_one_scene_of_zeros_and_ones_gives_the_beta_quantiles():
    # Sums of Gamma weights are Gamma: 7 of 10 give a Beta(0.8 * 7 + 0.5, 0.8 * 3 + 0.5),
    # scipy.stats.beta.ppf([0.025, 0.975], 6.1, 2.9) of scipy 1.17.
    found = mean_of_scenes([np.array([1.0] * 7 + [0.0] * 3)])
    assert found.interval.low == pytest.approx(0.36057, abs=0.015)
    assert found.interval.high == pytest.approx(0.92100, abs=0.015)


def test_perfect_scores_are_not_known_to_be_perfect():
    found = mean_of_scenes([np.ones(10)] * 4)
    assert found.mean == found.interval.high == 1.0
    assert 0.85 < found.interval.low < 0.99


def test_the_same_values_give_the_same_interval_in_any_order():
    rng = np.random.default_rng(4)
    values = [waypoints(rng, 10, 0.9) for _ in range(3)]
    shuffled = [rng.permutation(group) for group in values]
    assert mean_of_scenes(values) == mean_of_scenes(shuffled)


def test_nothing_can_be_estimated_from_nothing():
    with pytest.raises(ValueError, match="no values"):
        mean_of_scenes([np.array([])])


def test_empty_scenes_are_left_out():
    assert mean_of_scenes([np.array([]), np.ones(3)]).mean == 1.0


@settings(deadline=None, max_examples=40)
@given(groups)
def test_the_interval_holds_the_mean_within_the_range(values):
    found = mean_of_scenes(values)
    assert 0.0 <= found.interval.low <= found.mean <= found.interval.high <= 1.0
    assert found.interval.low < found.interval.high


@settings(deadline=None, max_examples=40)
@given(groups)
def test_more_confidence_is_a_wider_interval(values):
    narrow, wide = mean_of_scenes(values, 0.8).interval, mean_of_scenes(values, 0.99).interval
    assert wide.low <= narrow.low
    assert narrow.high <= wide.high


@pytest.mark.parametrize(
    ("q", "scenes", "trials"),
    [
        *((q, *sizes) for q in (0.7, 0.95, 0.99) for sizes in ((4, 4), (1, 10))),
        *(pytest.param(q, 9, 10, marks=pytest.mark.nightly) for q in (0.7, 0.95, 0.99)),
    ],
)
def test_coverage_is_near_nominal_where_plain_bootstraps_fail(scenes, trials, q):
    rng = np.random.default_rng(20261)
    passes = np.clip(q + np.linspace(-0.04, 0.01, scenes), 0.0, 1.0)
    truth = float(np.mean([true_mean(p) for p in passes]))
    repetitions = 150
    covered = 0
    for _ in range(repetitions):
        interval = mean_of_scenes([waypoints(rng, trials, p) for p in passes]).interval
        covered += interval.low <= truth <= interval.high
    # Nominal 0.95; 150 repetitions have a standard error of 0.018, so 0.90 is near three below.
    assert covered / repetitions >= 0.90


def test_many_trials_that_share_weights_have_the_interval_of_as_many_apart():
    # Sixty trials of three values; a little apart, so that none are equal, and no weight is shared.
    shared = np.repeat([0.25, 0.5, 1.0], 20)
    apart = shared - np.linspace(0.0, 1e-9, 60)
    one, two = mean_of_scenes([shared]), mean_of_scenes([apart])
    assert one.mean == pytest.approx(two.mean)
    assert one.interval.low == pytest.approx(two.interval.low, abs=0.006)
    assert one.interval.high == pytest.approx(two.interval.high, abs=0.006)
