from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from nw_gate.stats.betting import evidence_above, lower_bound, trials_to_certify, upper_bound

unit = st.floats(0.0, 1.0)
groups = st.lists(arrays(np.float64, st.integers(1, 12), elements=unit), min_size=1, max_size=5)


def mixed(successes: int, n: int) -> np.ndarray:
    return np.r_[np.ones(successes), np.zeros(n - successes)]


def test_one_trial_gives_the_wealth_that_one_can_work_out_by_hand():
    # A success at odds 1/m = 4 turns a bet of share b into 1 + 3 b: the mean of that over bets
    # 0.1, 0.25, 0.5, 0.75, 0.99 with weights 1, 2, 2, 1, 2 eighths is 1 + 3 * 0.54125.
    assert evidence_above([np.ones(1)], 0.25) == pytest.approx(2.62375, rel=1e-12)
    # A failure leaves 1 - b, whatever the odds.
    assert evidence_above([np.zeros(1)], 0.25) == pytest.approx(0.45875, rel=1e-12)


def test_evidence_is_fair_when_the_claim_is_just_true():
    # The expectation over all 2^6 outcomes of six trials of mean m is exactly one.
    m, total = 0.3, 0.0
    for outcome in range(64):
        bits = np.array([(outcome >> k) & 1 for k in range(6)], dtype=np.float64)
        total += float(np.prod(np.where(bits > 0, m, 1 - m))) * evidence_above([bits], m)
    assert total == pytest.approx(1.0, rel=1e-9)


def test_evidence_is_fair_or_less_when_trials_differ_in_difficulty():
    means = np.array([0.9, 0.5, 0.1, 0.7])
    total = 0.0
    for outcome in range(16):
        bits = np.array([(outcome >> k) & 1 for k in range(4)], dtype=np.float64)
        total += float(np.prod(np.where(bits > 0, means, 1 - means))) * evidence_above(
            [bits[:1], bits[1:2], bits[2:3], bits[3:]], float(means.mean())
        )
    assert total <= 1.0


@pytest.mark.parametrize(
    ("successes", "n", "exact"),
    [
        # Clopper and Pearson's one-sided 95 % bound for equal Bernoulli trials and a single look,
        # scipy.stats.beta.ppf(0.05, k, n - k + 1) of scipy 1.17: no valid bound is much higher.
        (10, 10, 0.7411),
        (45, 50, 0.8012),
        (81, 90, 0.8320),
        (90, 90, 0.9673),
        (270, 300, 0.8668),
    ],
)
def test_the_bound_is_below_the_exact_binomial_one_but_not_far(successes, n, exact):
    bound = lower_bound([mixed(successes, n)])
    assert exact - 0.08 < bound < exact


def test_without_trials_or_successes_nothing_is_certain():
    assert lower_bound([]) == 0.0
    assert upper_bound([]) == 1.0
    assert lower_bound([np.zeros(5)]) == 0.0
    assert upper_bound([np.ones(5)]) == 1.0
    assert evidence_above([], 0.5) == 1.0


def test_the_upper_bound_is_the_lower_bound_of_the_failures():
    assert upper_bound([mixed(10, 90)]) == pytest.approx(1.0 - lower_bound([mixed(80, 90)]))


@settings(deadline=None, max_examples=60)
@given(groups)
def test_the_bounds_hold_the_mean_between_them(values):
    mean = float(np.mean([group.mean() for group in values]))
    assert 0.0 <= lower_bound(values) <= mean + 1e-12
    assert mean - 1e-12 <= upper_bound(values) <= 1.0


@settings(deadline=None, max_examples=60)
@given(groups, st.data())
def test_a_better_trial_never_lowers_the_bound(values, data):
    better = [group.copy() for group in values]
    which = data.draw(st.integers(0, len(values) - 1))
    better[which][0] = data.draw(st.floats(float(better[which][0]), 1.0))
    assert lower_bound(better) >= lower_bound(values) - 1e-12


@settings(deadline=None, max_examples=30)
@given(groups)
def test_less_confidence_is_a_higher_bound(values):
    assert lower_bound(values, 0.8) >= lower_bound(values, 0.99)


@pytest.mark.parametrize("wrong", [-0.1, 1.1, float("nan")])
def test_values_outside_the_unit_interval_are_refused(wrong):
    with pytest.raises(ValueError, match="is not between 0 and 1"):
        lower_bound([np.array([0.5, wrong])])


@pytest.mark.parametrize(
    ("scenes", "trials", "q"),
    [
        (1, 10, 0.9),
        pytest.param(8, 10, 0.98, marks=pytest.mark.nightly),
        pytest.param(3, 30, 0.8, marks=pytest.mark.nightly),
    ],
)
def test_the_bound_is_too_high_at_most_as_often_as_it_promises(scenes, trials, q):
    rng = np.random.default_rng(20261)
    passes = np.clip(q + np.linspace(-0.1, 0.02, scenes), 0.0, 0.999)
    truth = float(np.mean([sum(p**k for k in range(1, 6)) / 5 for p in passes]))
    repetitions = 600
    wrong_low = wrong_high = 0
    for _ in range(repetitions):
        values = [np.cumprod(rng.random((trials, 5)) < p, axis=1).sum(axis=1) / 5 for p in passes]
        wrong_low += lower_bound(values, 0.9) > truth
        wrong_high += upper_bound(values, 0.9) < truth
    # At most 0.10 by proof; standard error 0.012, so 0.14 is more than three above.
    assert wrong_low / repetitions <= 0.14
    assert wrong_high / repetitions <= 0.14


def test_looking_after_every_round_keeps_the_promise():
    rng = np.random.default_rng(7)
    means = np.array([0.95, 0.8, 0.65])  # Equal Bernoulli trials within a scene, mean 0.8.
    repetitions, rounds, wrong = 300, 40, 0
    for _ in range(repetitions):
        draws = (rng.random((rounds, 3)) < means).astype(np.float64)
        wrong += any(
            evidence_above(list(draws[: look + 1].T), float(means.mean())) >= 10.0
            for look in range(rounds)
        )
    # A ten-fold win at any of 40 looks: at most 0.10 by Ville's inequality; standard error 0.017.
    assert wrong / repetitions <= 0.15


def test_the_fewest_perfect_trials_that_certify_a_bar_just_do():
    for bar in (0.5, 0.75, 0.9):
        fewest = trials_to_certify(bar)
        assert lower_bound([np.ones(fewest)]) >= bar
        assert lower_bound([np.ones(fewest - 1)]) < bar
