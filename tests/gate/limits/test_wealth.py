"""Bounds of a limit err as seldom as they say, by exact sums over all results."""

import numpy as np
import pytest

from nw_gate.limits.curves import Beliefs, Curves
from nw_gate.limits.search import Search
from nw_gate.limits.wealth import Wealth, growth


def exact(rates, share, trials, alpha, width=1):
    """Return the probabilities of a false lower and a false upper bound: every result is summed."""
    curves = Curves.over(len(rates), share)
    search = Search(curves=curves, share=share, confidence=1 - alpha, width=width, most=120)
    wealth, chance, wrong = Wealth.at_start(1, len(rates)), np.ones(1), np.zeros(2)
    limit = max((i for i, rate in enumerate(rates) if rate >= share), default=-1)
    for trial in range(trials + 1):
        ended = search.ended(wealth) | (trial == trials)
        low, high = wealth.bounds(1 - alpha)
        wrong += [chance[ended & (low > limit)].sum(), chance[ended & (high <= limit)].sum()]
        wealth, chance = wealth.some(~ended), chance[~ended]
        if not len(chance):
            break
        beliefs = search.beliefs(wealth)
        rung = search.next(wealth, beliefs)
        rate, of = np.array(rates)[rung], np.tile(np.arange(len(chance)), 2)
        done = np.arange(len(of)) < len(chance)
        chance = np.r_[chance * rate, chance * (1 - rate)]
        wealth, beliefs = wealth.some(of), Beliefs(*(each[of] for each in beliefs))
        wealth.bet(rung[of], done, beliefs, share)
    return wrong


@pytest.mark.parametrize("share", [0.5, 0.7])
@pytest.mark.parametrize("alpha", [0.05, 0.2])
def test_both_bounds_err_with_at_most_alpha_where_every_rung_is_at_the_share(share, alpha):
    at, below = [share] * 3, [share - 1e-9] * 3
    assert exact(at, share, 14, alpha)[1] <= alpha
    assert exact(below, share, 14, alpha)[0] <= alpha


def test_the_bounds_are_not_free_of_errors_so_the_sum_sees_them():
    assert exact([0.5] * 3, 0.5, 14, 0.2)[1] > 0.02


def test_no_bound_is_wrong_where_outcomes_are_certain():
    assert exact([1.0, 1.0, 0.0], 0.5, 14, 0.05).tolist() == [0.0, 0.0]


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_no_bet_gains_on_average_where_its_null_is_true(share):
    rng = np.random.default_rng(0)
    curves = Curves.over(6, share)
    for _ in range(20):
        done, missed = rng.integers(0, 6, (2, 1, 6)).astype(float)
        beliefs, rung = curves.beliefs(done, missed), np.array([rng.integers(6)])
        after = []
        for result in (True, False):
            wealth = Wealth.at_start(1, 6)
            wealth.bet(rung, np.array([result]), beliefs, share)
            after.append((np.exp(wealth.cleared[0]), np.exp(wealth.failed[0])))
        # At the share itself every bet is fair, on either side.
        for won, lost in zip(*after, strict=True):
            assert share * won + (1 - share) * lost == pytest.approx(np.ones(6))
        # A stake on "cleared" wins by completions alone, one on "not cleared" by failures.
        assert (after[0][0] >= after[1][0]).all()
        assert (after[0][1] <= after[1][1]).all()


def test_a_trial_bets_for_rungs_that_are_no_harder_and_against_those_that_are_no_easier():
    wealth, curves = Wealth.at_start(1, 5), Curves.over(5, 0.5)
    wealth.bet(np.array([2]), np.array([True]), curves.beliefs(wealth.done, wealth.missed), 0.5)
    assert (wealth.cleared[0, :3] > 0).all()
    assert (wealth.cleared[0, 3:] == 0).all()
    assert (wealth.failed[0, :2] == 0).all()
    assert (wealth.failed[0, 2:] < 0).all()


def test_a_claim_needs_the_claims_before_it():
    wealth = Wealth.at_start(1, 4)
    wealth.most_cleared[0] = np.log([30.0, 10.0, 30.0, 1.0])
    wealth.most_failed[0] = np.log([1.0, 30.0, 20.0, 20.0])
    assert [int(bound[0]) for bound in wealth.bounds(0.95)] == [0, 1]


def test_growth_is_the_divergence_of_two_coins():
    # 0.75 ln 1.5 + 0.25 ln 0.5 = 0.130812, by hand.
    assert growth(np.array([0.75]), 0.5)[0] == pytest.approx(0.130812, abs=1e-6)


def test_expected_rates_fall_along_the_ladder_and_follow_the_trials():
    curves = Curves.over(8, 0.5)
    none = np.zeros((1, 8))
    before = curves.beliefs(none, none)
    assert (np.diff(before.rate[0]) <= 0).all()
    assert before.cleared[0] == pytest.approx(np.full(9, 1 / 9), abs=1e-6)
    done = none.copy()
    done[0, 4] = 6
    after = curves.beliefs(done, none)
    assert (after.rate >= before.rate).all()
    assert (after.if_cleared >= after.if_not).all()
