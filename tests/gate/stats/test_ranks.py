"""Ranks are decided only where they are, and then rightly."""

from __future__ import annotations

import numpy as np
import pytest

from nw_gate.stats.ranks import Ranks, possible_ranks


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


def capital(difference, n):
    """Return what becomes of 1 in one scene with n equal differences: worked out trial by trial.

    Half bets fixed shares, and half the share that the mean and the mean square before suggest.
    """
    shares, weights = (0.1, 0.25, 0.5, 0.75, 0.99), (1, 2, 2, 1, 2)
    fixed = sum(w / 8 * (1 + b * difference) ** n for b, w in zip(shares, weights, strict=True))
    learnt = 0.0
    for cap, part in ((0.5, 0.25), (0.9, 0.5), (0.99, 0.25)):
        stake, total, squares = part, 5 * 0.25, 5 * (0.3 + 0.25**2)
        for _ in range(n):
            stake *= 1 + min(max(total, 0.0) / squares, cap) * difference
            total, squares = total + difference, squares + difference**2
        learnt += stake
    return (fixed + learnt) / 2


def test_what_decides_is_the_bet_that_one_can_work_out_by_hand():
    # Of two policies: E must be over 20 by as much as the other claim's E is below it.
    has = {n: capital(1.0, n) - 20 >= 20 - capital(-1.0, n) for n in range(4, 10)}
    first = next(n for n, is_enough in has.items() if is_enough)
    for n in has:
        decided = possible_ranks([flat(1.0, 1, n), flat(0.0, 1, n)])[0].decided
        assert decided == (n >= first)
    assert first == 7


def test_what_some_rounds_decided_stays_decided_till_others_decide_against_it():
    better, worse = np.repeat([1.0, 0.0], [9, 30]), np.zeros(39)
    assert possible_ranks([[better], [worse]])[0].decided
    assert possible_ranks([[better], [1.0 - better]]) == (Ranks(best=1, worst=2),) * 2


def test_of_starts_that_are_not_as_many_in_each_scene_whole_rounds_decide_or_all_together():
    uneven = [np.ones(count) for count in (8, 8, 10)]
    assert possible_ranks([uneven, [0.0 * scene for scene in uneven]])[0].decided
    one_is_short = [np.ones(30), np.ones(4)]
    assert possible_ranks([one_is_short, [0.0 * scene for scene in one_is_short]])[0].decided


def drawn(rng, chances, scenes, starts=10):
    """Return successes that are all or nothing; two policies share half of their luck each."""
    shared = rng.random((1, scenes, starts))
    own = rng.random((len(chances), scenes, starts))
    luck = np.where(rng.random(own.shape) < 0.5, shared, own)
    return [[*each] for each in (luck < np.array(chances)[:, None, None]).astype(float)]


def test_ten_starts_in_sixteen_scenes_tell_70_from_95_percent_and_in_four_they_often_do():
    """Of 400 comparisons in four scenes 62 % are decided; fixed bets alone decided 52 %."""
    rng = np.random.default_rng(4)
    four = [possible_ranks(drawn(rng, (0.95, 0.7), 4))[0].decided for _ in range(200)]
    assert np.mean(four) >= 0.55
    assert all(possible_ranks(drawn(rng, (0.95, 0.7), 16))[0].decided for _ in range(20))


def test_scenes_weigh_equally_however_many_starts_they_have():
    one = [np.ones(40), np.zeros(10)]
    other = [np.zeros(40), np.ones(10)]
    assert possible_ranks([one, other]) == (Ranks(best=1, worst=2),) * 2


def test_policies_with_other_starts_are_not_ranked():
    with pytest.raises(ValueError, match="different numbers of initial states"):
        possible_ranks([flat(1.0, starts=3), flat(1.0, starts=4)])


@pytest.mark.nightly
@pytest.mark.parametrize("correlated", [False, True])
@pytest.mark.parametrize("shape", ["all or nothing", "rare catastrophe", "other scenes"])
def test_true_ranks_are_missed_in_at_most_one_comparison_of_twenty(shape, correlated):
    """Five equal policies, 16 scenes of 10 starts, 2,000 comparisons.

    The nominal is 100, and wrong were 21, 20, 0, 0, 5 and 2. Of equal policies every order that is
    decided is wrong. Those of the last shape are equal in the mean, and each is better than others
    in half of the scenes.
    """
    rng = np.random.default_rng(7)
    chances = np.full((5, 16, 1), 0.8)
    if shape == "other scenes":
        halves = np.tile(np.repeat([-0.2, 0.2], 8), (5, 1))
        chances += rng.permuted(halves, axis=1)[..., None]
    wrong = 0
    for _ in range(2000):
        luck = rng.random((1 if correlated else 5, 16, 10))
        luck = np.where(rng.random((5, 16, 10)) < 0.5, luck, rng.random((5, 16, 10)))
        success = np.where(luck < 0.02, 0.0, 0.95)
        if shape != "rare catastrophe":
            success = luck < chances
        ranks = possible_ranks([[*policy.astype(float)] for policy in success])
        wrong += any(each != Ranks(best=1, worst=5) for each in ranks)
    assert wrong / 2000 <= 0.05, wrong
