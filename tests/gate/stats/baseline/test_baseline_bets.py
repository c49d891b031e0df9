"""Bets made from the baseline are fair, grow fastest, and save trials."""

from __future__ import annotations

from dataclasses import replace
from math import inf

import gate_cells
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_evidence import in_all_orders, panels, trials_of

from nw_gate.stats.baseline.baseline_bets import SHARE_ABOVE, SHARE_BELOW, make_bets
from nw_gate.stats.baseline.evidence import Margins, Reference, nulls_at_least
from nw_gate.stats.baseline.interval import drop_interval_after
from nw_gate.stats.baseline.trials import (
    DrawnTrials,
    TrialRules,
    above_at,
    below_at,
    looks,
    settle_all,
)


def reference_of(
    scores: np.ndarray,
    margins: Margins,
    *,
    waypoints: int = 4,
    by_start: bool = True,
    starts: float = inf,
) -> Reference:
    bets = make_bets(
        scores,
        np.full(scores.shape[-2], waypoints),
        max_drop=margins.max_drop,
        tolerate=margins.tolerate,
        by_start=by_start,
    )
    return Reference(means=scores.mean(axis=-1), starts=starts, bets=bets)


def hurdles(gates: int, drop: float, seed: int = 3) -> tuple[Reference, DrawnTrials, np.ndarray]:
    """Gates on the committed baseline: all of it known, and the candidate's own 320 trials."""
    scores, waypoints = gate_cells.scores_of(gate_cells.HURDLES)
    rng = np.random.default_rng(seed)
    cell = next(gate_cells.cells())
    cell = replace(cell, kind="harder", drop=drop)
    drawn, starts = gate_cells._draw(rng, *scores.shape, 320, gates)
    candidate = gate_cells._candidate(scores, waypoints, cell, rng)(drawn, starts)
    trials = DrawnTrials(scenes=drawn, candidate=candidate, baseline=scores[drawn, starts])
    return reference_of(scores, Margins()), trials, scores


@settings(deadline=None, max_examples=40)
@given(panels, st.booleans(), st.sampled_from([1, 2, 3, 4, 7]))
def test_at_the_margin_the_mean_over_all_orders_is_at_most_one(panel, by_start, waypoints):
    better, worse = sorted(panel, key=lambda scores: -scores.mean())
    drop = float(better.mean() - worse.mean())
    if drop >= 1.0:
        return
    margins = Margins(max_drop=drop, tolerate=drop)
    reference = reference_of(
        better, margins, waypoints=waypoints, by_start=by_start, starts=better.shape[1]
    )
    for which in (reference, reference.fresh()):
        found = looks(which, in_all_orders(better, worse), margins)
        for evidence in (found.passed, found.regressed):
            assert evidence.mean(axis=0).max() <= 1.0 + 1e-9


@pytest.mark.parametrize("side", ["above", "below"])
def test_no_other_bet_of_the_same_null_grows_faster_if_the_baseline_is_what_comes(side):
    """Random changes of a and l that keep the null's mean at 1 find none that is better."""
    rng = np.random.default_rng(5)
    scores = rng.random((5, 200, 4)) < np.array([0.9, 0.95, 0.97, 0.99, 0.8])[:, None, None]
    scores = scores.cumprod(-1).sum(-1) / 4
    # The guess of no drop; or, for REGRESSED, what the bets of the largest drop were made for.
    margins = Margins(max_drop=0.1)
    reference = reference_of(scores, margins, by_start=False)
    assert reference.bets is not None
    account = getattr(reference.bets, side)[0 if side == "above" else -1]
    mean = scores.mean()
    null = mean - 0.1 if side == "above" else 1.0 - (mean - 0.02)
    if side == "below":  # Each waypoint is kept with the chance that takes .2 off the mean.
        chances = np.linspace(0, 1, 100001)
        reached = [np.mean(scores * 4 >= step) for step in range(1, 5)]
        found = sum(r * chances**step for step, r in enumerate(reached, start=1)) / 4
        kept = chances[np.argmin(abs(found - (mean - 0.2)))]
        lost = rng.random((40, 5, 200, 4)) < kept
        scores = np.minimum(scores[None] * 4, lost.cumprod(-1).sum(-1)) / 4
        scores = np.moveaxis(scores, 0, 1).reshape(5, -1)
    y = scores if side == "above" else 1.0 - scores

    def growth(fixed: np.ndarray, slope: float) -> float:
        whole = fixed.mean() + slope * null
        return float(np.log((fixed[:, None] + slope * y) / whole).mean())

    fixed, slope = account.fixed[:, 0], float(account.slope)
    best = growth(fixed, slope)
    assert best > 0.01
    for _ in range(2000):
        other = np.maximum(fixed + rng.normal(0, 0.1, 5), 0.0)
        assert growth(other, max(slope * (1 + rng.normal(0, 0.2)), 0.0)) < best + 2e-3


def test_numbers_are_rounded_so_that_last_digits_of_a_processor_do_not_count():
    reference, _, _ = hurdles(1, 0.0)
    assert reference.bets is not None
    for account in (*reference.bets.above, *reference.bets.below):
        for number in (account.fixed, account.slope):
            assert np.array_equal(number * 2.0**24, np.rint(number * 2.0**24))


def test_all_capital_is_placed_and_a_part_stays_on_the_fixed_bets():
    reference, trials, _ = hurdles(2, 0.0)
    plain = looks(replace(reference, bets=None), trials, Margins())
    whole = looks(reference, trials, Margins())
    assert (whole.passed >= (1 - SHARE_ABOVE) * plain.passed * (1 - 1e-12)).all()
    assert (whole.regressed >= (1 - SHARE_BELOW) * plain.regressed * (1 - 1e-12)).all()
    assert reference.bets is not None
    for side, share in ((reference.bets.above, SHARE_ABOVE), (reference.bets.below, SHARE_BELOW)):
        assert sum(account.weight for account in side) == pytest.approx(share)


@pytest.mark.parametrize(("drop", "most", "before"), [(0.1, 0.88, 95), (0.2, 0.8, 37)])
def test_a_regression_takes_fewer_trials_than_with_fixed_bets(drop, most, before):
    reference, trials, _ = hurdles(300, drop)
    rules = TrialRules(tiers=("supporting",) * 16)
    made, fixed = (
        np.mean([each.trials for each in settle_all(which, trials, rules)])
        for which in (reference, replace(reference, bets=None))
    )
    assert made <= most * fixed
    assert fixed > before


def test_what_the_baseline_scored_counts_only_where_starts_are_the_same():
    scores, margins = np.tile([[1.0, 1.0, 0.5, 0.25]], (3, 8)), Margins()
    rng = np.random.default_rng(2)
    order = rng.permutation(scores.size)
    trials = trials_of(order, scores, rng.choice([0.5, 1.0], scores.shape))
    other = replace(trials, baseline=np.roll(trials.baseline, 1))
    for by_start in (True, False):
        reference = reference_of(scores, margins, by_start=by_start)
        reference = replace(reference, paired=False)
        accounts = slice(len(reference.betas), None)
        one, two = (above_at(reference, which)[accounts] for which in (trials, other))
        assert np.array_equal(one, two) != by_start


def test_a_result_that_the_baseline_never_had_takes_no_account_all():
    scores = np.full((4, 30), 0.75)
    scores[0] = 1.0
    reference = reference_of(scores, Margins())
    for candidate in (0.0, 0.25, 0.6, 1.0):
        seen = np.full((4, 30), candidate)
        trials = trials_of(np.arange(20), scores, seen)
        for values in (above_at(reference, trials), below_at(reference, trials)):
            for account in values[len(reference.betas) :]:
                assert account.min() > 0.0


@pytest.mark.parametrize("mean", [0.75, 1.0])
def test_where_no_guess_is_better_than_the_null_nothing_is_bet(mean):
    scores = np.full((2, 30), mean)
    margins = Margins(max_drop=0.0, tolerate=0.0)
    reference = reference_of(scores, margins)
    trials = trials_of(np.arange(10), scores, scores)
    every = zip(above_at(reference, trials), nulls_at_least(reference, 0.0), strict=True)
    for values, null in list(every)[len(reference.betas) :]:
        assert (values == 1.0).all()
        assert null == 1.0


@pytest.mark.parametrize("claim", ["panel", "fresh"])
@pytest.mark.parametrize("drop", [0.0, 0.06, 0.2])
def test_interval_and_verdict_agree(claim, drop):
    reference, trials, _ = hurdles(12, drop)
    margins = Margins()
    if claim == "panel":
        reference = replace(reference, starts=60)
    rules = TrialRules(tiers=("supporting",) * 16)
    for gate, decision in enumerate(settle_all(reference, trials, rules)):
        first = trials.only(np.array([gate]), decision.mean)
        one = DrawnTrials(
            scenes=first.scenes[0], candidate=first.candidate[0], baseline=first.baseline[0]
        )
        low, high = drop_interval_after(reference, one)
        assert (low >= margins.tolerate - 1e-7) == (decision.word == "REGRESSED")
        if decision.word == "PASS":
            assert high <= margins.max_drop + 1e-7


@settings(deadline=None, max_examples=30)
@given(panels, st.randoms(use_true_random=False), st.booleans())
def test_a_better_trial_helps_to_pass_and_never_convicts(panel, rng, fresh):
    order = np.array(rng.sample(range(panel[0].size), panel[0].size))
    reference = reference_of(panel[1], Margins(), starts=panel[1].shape[1])
    reference = reference.fresh() if fresh else reference
    worse = looks(reference, trials_of(order, panel[1], panel[0]), Margins())
    better = looks(reference, trials_of(order, panel[1], panel.max(axis=0)), Margins())
    assert (better.passed >= worse.passed * (1 - 1e-9)).all()
    assert (better.regressed * (1 - 1e-9) <= worse.regressed).all()


def test_bets_of_several_baselines_are_those_of_each_alone():
    rng = np.random.default_rng(8)
    scores = rng.choice([0.5, 1.0, 1.0], (5, 3, 20))
    reference = reference_of(scores, Margins(), waypoints=2)
    order = np.argsort(rng.random((5, 60)), axis=1)
    scenes = order // 20
    candidate = rng.choice([0.0, 1.0], order.shape)
    baseline = np.take_along_axis(scores.reshape(5, -1), order, axis=1)
    together = looks(
        reference, DrawnTrials(scenes=scenes, candidate=candidate, baseline=baseline), Margins()
    )
    for gate in range(5):
        alone = looks(
            reference_of(scores[gate], Margins(), waypoints=2),
            DrawnTrials(scenes=scenes[gate], candidate=candidate[gate], baseline=baseline[gate]),
            Margins(),
        )
        assert together.passed[gate] == pytest.approx(alone.passed, rel=1e-12)
        assert together.regressed[gate] == pytest.approx(alone.regressed, rel=1e-12)
