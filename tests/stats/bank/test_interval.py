"""The interval of the drop says what the verdicts say, and covers the truth as often as it says."""

from __future__ import annotations

from itertools import permutations, product
from math import nan

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from nw_eval.stats import Interval
from nw_eval.stats.bank import Bank, Margins, drop_interval, over_rounds, scene_drop_intervals

shares = st.sampled_from([0.0, 0.25, 1 / 3, 0.5, 0.8, 1.0])
campaigns = st.tuples(st.integers(1, 4), st.integers(1, 12)).flatmap(
    lambda shape: arrays(np.float64, (3, *shape), elements=shares)
)


def interval(bank: np.ndarray, candidate: np.ndarray, **alphas: float) -> Interval:
    """Of all rounds in the order of the columns; both shapes (S, R)."""
    return drop_interval(Bank.of(bank), candidate.T, bank.T, **alphas)


@settings(deadline=None, max_examples=60)
@given(campaigns, st.sampled_from([0.02, 0.1, 0.3]))
def test_pass_is_a_high_end_below_the_margin_and_regressed_a_low_end_above_it(
    scores: np.ndarray, margin: float
) -> None:
    if scores[0].mean(axis=-1).mean() <= margin + 1e-6:
        return  # No policy can be so much worse.
    bank = Bank.of(scores[0])
    found = drop_interval(bank, scores[1].T, scores[0].T, alpha_pass=0.2, alpha_regr=0.2)
    margins = Margins(max_drop=margin, tolerate=margin)
    last = over_rounds(bank, scores[1].T, scores[0].T, margins)[-1]
    passes, convicts = last.passed >= 5.0, last.regressed >= 5.0
    if not (passes and convicts):
        assert found.high <= margin + 1e-7 if passes else found.high >= margin - 1e-7
        assert found.low >= margin - 1e-7 if convicts else found.low <= margin + 1e-7


@settings(deadline=None, max_examples=40)
@given(campaigns)
def test_better_trials_never_move_an_end_up(scores: np.ndarray) -> None:
    worse = interval(scores[0], scores[1], alpha_pass=0.2, alpha_regr=0.2)
    better = interval(scores[0], scores[1:].max(axis=0), alpha_pass=0.2, alpha_regr=0.2)
    assert better.low <= worse.low + 1e-7
    assert better.high <= worse.high + 1e-7


def test_without_rounds_every_drop_is_possible_and_with_all_of_them_hardly_any() -> None:
    rng = np.random.default_rng(8)
    bank, candidate = rng.integers(0, 6, (2, 6, 40)) / 5
    nothing = drop_interval(Bank.of(bank), np.zeros((0, 6)), np.zeros((0, 6)))
    assert nothing == pytest.approx((bank.mean() - 1.0, bank.mean()))
    drop = bank.mean() - candidate.mean()
    assert interval(bank, candidate) == pytest.approx((drop, drop), abs=0.01)
    half = Bank.of(bank), candidate.T[:20], bank.T[:20]
    some, wider = drop_interval(*half), drop_interval(*half, alpha_pass=0.001, alpha_regr=0.001)
    assert wider.low < some.low < drop < some.high < wider.high
    assert some.high - some.low < 0.4


def test_a_missing_trial_widens_it_on_both_sides() -> None:
    rng = np.random.default_rng(9)
    bank, candidate = rng.integers(2, 6, (2, 4, 12)) / 5
    gap = candidate.copy()
    gap[1, 3] = nan
    best, worst = np.where(np.isnan(gap), 1.0, gap), np.where(np.isnan(gap), 0.0, gap)
    found = interval(bank, gap)
    assert found == (interval(bank, best).low, interval(bank, worst).high)
    assert found.low < interval(bank, worst).low


def test_over_all_orders_of_a_panel_each_end_errs_as_often_as_it_may() -> None:
    bank = np.array([[1.0, 1.0, 0.5], [1.0, 1.0, 0.0]])
    candidate = np.array([[1.0, 0.5, 0.0], [0.5, 1.0, 0.0]])
    drop, errors = bank.mean() - candidate.mean(), np.zeros(2)
    orders = list(product(permutations(range(3)), repeat=2))
    for order in orders:
        c, b = (np.take_along_axis(x, np.array(order), axis=1).T for x in (candidate, bank))
        looks = [
            drop_interval(Bank.of(bank), c[:r], b[:r], alpha_pass=0.4, alpha_regr=0.3)
            for r in (1, 2)
        ]
        errors += [
            any(look.high < drop - 1e-7 for look in looks),
            any(look.low > drop + 1e-7 for look in looks),
        ]
    assert (errors > 0).any()
    assert errors[0] <= 0.4 * len(orders)
    assert errors[1] <= 0.3 * len(orders)


@settings(deadline=None, max_examples=40)
@given(campaigns)
def test_a_scene_alone_has_the_interval_of_a_bank_of_that_scene(scores: np.ndarray) -> None:
    together = scene_drop_intervals(Bank.of(scores[0]), scores[1].T, scores[0].T)
    for scene, found in enumerate(together):
        one = slice(scene, scene + 1)
        alone = interval(scores[0][one], scores[1][one])
        assert found.low == pytest.approx(alone.low, abs=1e-4)
        assert found.high == pytest.approx(alone.high, abs=1e-4)
