"""A limit says its bounds in units, and is the same after it was saved."""

import json

import numpy as np
import pytest

from nw_base.errors import StoreError
from nw_gate import Ladder, Limit, find_limit

BARS = Ladder(name="bar height", unit="m", rungs=(0.18, 0.22, 0.26, 0.3, 0.34, 0.38, 0.42))
CLEARANCE = Ladder(name="clearance", unit="m", rungs=(0.5, 0.45, 0.4, 0.35, 0.3, 0.25))


def cliff(ladder, limit, **options):
    """Return the limit of a policy that completes all trials up to a rung, and none beyond."""
    return find_limit(ladder, lambda trial: trial.rung <= limit, **options)


def test_bounds_are_rungs_with_their_values():
    found = cliff(BARS, 3, width=1)
    assert found.decided
    assert found.lower == (3, pytest.approx(0.30))
    assert found.upper == (4, pytest.approx(0.34))
    assert found.sentence == (
        f"bar height: at least 50 % of trials up to 0.3 m, fewer at 0.34 m; "
        f"{len(found.trials)} trials."
    )


def test_a_policy_that_clears_all_or_no_rung_has_one_bound_within_ten_trials():
    all_of_them, none = cliff(BARS, 9, width=1), cliff(BARS, -1, width=1)
    assert all_of_them.lower is not None
    assert all_of_them.upper is None
    assert (none.lower, none.upper) == (None, (0, pytest.approx(0.18)))
    assert max(len(all_of_them.trials), len(none.trials)) <= 10
    assert "up to 0.42 m (the last rung)" in all_of_them.sentence
    assert "fewer than 50 % of trials at 0.18 m, no lower bound" in none.sentence


def test_a_ladder_may_fall_in_value():
    found = cliff(CLEARANCE, 2, width=1)
    assert (found.lower.value, found.upper.value) == (0.4, 0.35)
    assert "down to 0.4 m, fewer at 0.35 m" in found.sentence


def test_an_undecided_limit_says_so():
    found = cliff(BARS, 3, width=1, most=3)
    assert (found.lower, found.upper, found.decided) == (None, None, False)
    assert found.sentence == (
        "bar height: no rung is shown to be over or under 50 % of trials; 3 trials, undecided at "
        "a width of 1 rung."
    )


def test_the_curve_falls_within_its_band_and_counts_every_trial():
    found = cliff(BARS, 3)
    assert sum(point.tried for point in found.curve) == len(found.trials)
    assert [point.value for point in found.curve] == list(BARS.rungs)
    assert all(0 < point.low <= point.rate <= point.high < 1 for point in found.curve)
    assert (np.diff([point.rate for point in found.curve]) <= 0).all()
    assert cliff(BARS, 3, width=1).estimate.rung == 3


def test_another_share_finds_another_limit():
    rates, results = [1.0, 1.0, 1.0, 0.75, 0.7, 0.0, 0.0], np.random.default_rng(0)
    draws = {
        share: find_limit(
            BARS, lambda t: bool(results.random() < rates[t.rung]), share=share, width=2
        )
        for share in (0.5, 0.9)
    }
    assert draws[0.5].ends[1] > draws[0.9].ends[1]


def test_a_dip_is_looked_for_and_said():
    done = {0: True, 1: False, 2: True, 3: True, 4: True}
    found = find_limit(BARS, lambda trial: done.get(trial.rung, False), check=2)
    assert found.dip.easier == 1
    assert "The curve is not monotone: 0 of " in found.sentence
    before = found.trials[: found.staked]
    assert found.ends == find_limit(BARS, lambda trial: done.get(trial.rung, False)).ends
    assert len(before) < len(found.trials)


def test_a_saved_limit_is_the_same():
    found = cliff(BARS, 3, check=1)
    again = Limit.from_dict(json.loads(json.dumps(found.as_dict())))
    assert again == found
    assert (again.sentence, again.ends) == (found.sentence, found.ends)


@pytest.mark.parametrize(
    "damage",
    [
        {"rungs": [1.0]},
        {"rungs": "x"},
        {"trials": [[7, 1]]},
        {"trials": [[0, 1, 2]]},
        {"trials": None},
        {"share": 2.0},
        {"confidence": "sure"},
        {"expected": []},
        {"expected": float("inf")},
    ],
)
def test_a_damaged_limit_is_refused(damage):
    saved = cliff(BARS, 3).as_dict()
    with pytest.raises(StoreError, match="saved limit"):
        Limit.from_dict(saved | damage)
    with pytest.raises(StoreError, match="saved limit"):
        Limit.from_dict({name: value for name, value in saved.items() if name not in damage})


def test_a_search_that_cannot_reach_its_width_still_bounds_the_limit():
    """A policy that completes half of its trials on several rungs has no two bounds so near."""
    rates = [1.0] * 8 + [0.85, 0.62, 0.52, 0.5, 0.48, 0.12]
    for seed in range(5):
        rng = np.random.default_rng(seed)
        found = find_limit(
            Ladder(name="gap", rungs=tuple(range(len(rates)))),
            lambda trial, rng=rng: bool(rng.random() < rates[trial.rung]),
        )
        low, high = found.ends
        assert 6 <= low <= 11
        assert high == 13
        assert not found.decided
