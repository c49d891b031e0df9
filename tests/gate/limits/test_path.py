"""The order of trials depends on their results alone, with any number of workers."""

import numpy as np
import pytest

from nw_base.errors import UsageError
from nw_gate import Ladder, LimitSearch, LimitTrial, find_limit

LADDER = Ladder(name="step", unit="m", rungs=(0.04, 0.08, 0.12, 0.16, 0.2, 0.24, 0.28, 0.32))
RATES = [1.0, 1.0, 0.95, 0.9, 0.8, 0.3, 0.0, 0.0]


def results(seed):
    """Return a policy whose trial depends on its rung and number alone."""
    return lambda trial: bool(np.random.default_rng([seed, *trial]).random() < RATES[trial.rung])


@pytest.mark.parametrize("workers", [2, 4, 8])
def test_any_number_of_workers_finds_the_same_limit_by_the_same_trials(workers):
    for seed in range(4):
        one, policy = find_limit(LADDER, results(seed)), results(seed)
        search, ran = LimitSearch(LADDER), 0
        while search.next is not None:
            # Results arrive in the opposite order.
            for trial in reversed(search.ahead(workers)):
                search.tell(trial, policy(trial))
                ran += 1
        assert search.limit == one
        assert len(one.trials) <= ran <= len(one.trials) * workers


def test_trials_ahead_begin_with_the_one_that_is_needed_and_are_all_different():
    search = LimitSearch(LADDER)
    ahead = search.ahead(6)
    assert ahead[0] == search.next
    assert len(set(ahead)) == 6
    assert LimitSearch(LADDER).ahead(6) == ahead


def test_a_result_that_is_told_again_changes_nothing_and_another_one_is_refused():
    search = LimitSearch(LADDER)
    first = search.next
    search.tell(first, True)
    before = search.trials
    search.tell(first, True)
    assert search.trials == before == ((first.rung, True),)
    with pytest.raises(UsageError, match="two results"):
        search.tell(first, False)


@pytest.mark.parametrize("trial", [LimitTrial(8, 0), LimitTrial(-1, 0), LimitTrial(0, -1)])
def test_a_trial_off_the_ladder_is_refused(trial):
    with pytest.raises(UsageError, match="not asked for"):
        LimitSearch(LADDER).tell(trial, True)


def test_a_search_ends_when_its_trials_are_spent():
    limit = find_limit(LADDER, results(0), width=1, most=9)
    assert (len(limit.trials), limit.decided) == (9, False)


@pytest.mark.parametrize(
    "options",
    [{"share": 1.0}, {"confidence": 95.0}, {"width": 0}, {"width": 9}, {"most": 0}, {"check": -1}],
)
def test_options_that_cannot_be_used_are_refused(options):
    (value,) = options.values()
    with pytest.raises(UsageError, match=f"{value:g}"):
        LimitSearch(LADDER, **options)


@pytest.mark.parametrize("rungs", [(1.0,), (1.0, 1.0), (1.0, 3.0, 2.0), (0.0, float("nan"))])
def test_rungs_that_neither_rise_nor_fall_are_refused(rungs):
    with pytest.raises(UsageError, match="ladder 'x'"):
        Ladder(name="x", rungs=rungs)
