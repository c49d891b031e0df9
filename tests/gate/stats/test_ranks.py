"""Ranks are decided only where they are, and then rightly."""

from __future__ import annotations

import numpy as np
import pytest

from nw_gate.stats.betting import Ranks, possible_ranks


def flat(success, scenes=4, starts=10):
    return [np.full(starts, success) for _ in range(scenes)]


def test_policies_far_apart_are_ranked_and_each_alone_in_its_rank():
    ranks = possible_ranks([flat(0.0), flat(1.0), flat(0.5)])
    assert ranks == (Ranks(best=3, worst=3), Ranks(best=1, worst=1), Ranks(best=2, worst=2))
    assert all(each.decided for each in ranks)


def test_equal_policies_may_have_any_rank():
    assert possible_ranks([flat(0.7)] * 3) == (Ranks(best=1, worst=3),) * 3


def test_of_two_that_are_close_neither_is_ranked_and_a_third_may_be():
    rng = np.random.default_rng(2)
    near = [[rng.integers(3, 5, 10) / 4 for _ in range(4)] for _ in range(2)]
    assert possible_ranks([*near, flat(0.0)]) == (
        Ranks(best=1, worst=2),
        Ranks(best=1, worst=2),
        Ranks(best=3, worst=3),
    )


def test_what_decides_is_the_bet_that_one_can_work_out_by_hand():
    # One scene, n starts, 1 against 0: a bet of share b makes (1 + b)^n. With the shares and
    # weights of `betting`, p is 1/E, and twice that for Holm's two claims.
    shares, weights = (0.1, 0.25, 0.5, 0.75, 0.99), (1, 2, 2, 1, 2)
    p = {
        n: 1 / sum(w / 8 * (1 + b) ** n for b, w in zip(shares, weights, strict=True))
        for n in range(4, 10)
    }
    first = next(n for n in p if 2 * p[n] <= 0.05)
    for n in p:
        decided = possible_ranks([flat(1.0, 1, n), flat(0.0, 1, n)])[0].decided
        assert decided == (n >= first)
    assert first == 7


def test_scenes_weigh_equally_however_many_starts_they_have():
    one = [np.ones(40), np.zeros(10)]
    other = [np.zeros(40), np.ones(10)]
    assert possible_ranks([one, other]) == (Ranks(best=1, worst=2),) * 2


def test_policies_with_other_starts_are_not_ranked():
    with pytest.raises(ValueError, match="other numbers of starts"):
        possible_ranks([flat(1.0, starts=3), flat(1.0, starts=4)])


@pytest.mark.nightly
@pytest.mark.parametrize("correlated", [False, True])
@pytest.mark.parametrize("shape", ["all or nothing", "rare catastrophe"])
def test_true_ranks_are_missed_in_at_most_one_comparison_of_twenty(shape, correlated):
    """Five equal policies, 16 scenes of 10 starts, 2,000 comparisons: wrong 2, 0, 0, 0 times.

    The nominal is 100. Of equal policies every order that is decided is wrong.
    """
    rng = np.random.default_rng(7)
    wrong = 0
    for _ in range(2000):
        luck = rng.random((1 if correlated else 5, 16, 10))
        luck = np.where(rng.random((5, 16, 10)) < 0.5, luck, rng.random((5, 16, 10)))
        success = (luck < 0.8) if shape == "all or nothing" else np.where(luck < 0.02, 0.0, 0.95)
        ranks = possible_ranks([[*policy.astype(float)] for policy in success])
        wrong += any(each != Ranks(best=1, worst=5) for each in ranks)
    assert wrong / 2000 <= 0.05
