"""Which trials are drawn: as many as asked for, by the seed and nothing else."""

import pytest

from nw_base.errors import UsageError
from nw_eval.engine.order import check_sample, draw, unforeseen_seed

TRIALS = [f"hurdles-one-{index:03d}" for index in range(100)]


@pytest.mark.parametrize(
    ("sample", "count"),
    [("5%", 5), ("5.1 %", 6), ("0.01%", 1), ("100%", 100), ("1", 1), ("7", 7), ("5000", 100)],
)
def test_as_many_are_drawn_as_are_asked_for_at_least_one_and_each_once(sample, count):
    check_sample(sample)
    drawn = draw(TRIALS, sample, seed=3)
    assert len(set(drawn)) == len(drawn) == count
    assert set(drawn) <= set(TRIALS)


@pytest.mark.parametrize("sample", ["", "0", "0%", "101%", "-1", "5%%", "many", "1e3", "٣"])
def test_what_is_no_share_and_no_number_is_refused(sample):
    with pytest.raises(UsageError, match="--trials"):
        check_sample(sample)


def test_a_seed_draws_the_same_trials_in_whatever_order_they_are_and_another_draws_others():
    assert draw(TRIALS, "5%", 3) == draw(TRIALS[::-1], "5%", 3)
    assert len({draw(TRIALS, "5%", seed) for seed in range(20)}) == 20


def test_every_trial_is_drawn_about_as_often():
    counts = dict.fromkeys(TRIALS, 0)
    for seed in range(1000):
        for name in draw(TRIALS, "5%", seed):
            counts[name] += 1
    # 50 are expected of each, with a standard deviation of 7.
    assert 20 < min(counts.values()) <= max(counts.values()) < 90


def test_no_two_seeds_are_alike():
    assert len({unforeseen_seed() for _ in range(100)}) == 100
