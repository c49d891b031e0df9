"""Which scenes tell policies apart, and whether a suite of them keeps a gate's errors."""

from __future__ import annotations

from math import inf, log

import numpy as np
import pytest

from nw_gate.baseline.informative import items_of, propose, rung_counts
from nw_gate.baseline.power_forecast import Outset
from nw_gate.stats.baseline.baseline_bets import make_bets
from nw_gate.stats.baseline.evidence import Reference
from nw_gate.stats.baseline.trials import DrawnTrials, TrialRules, settle_all
from nw_gate.stats.power import SceneCounts

GATES, SCENES, CHOSEN, STARTS, BUDGET = 200, 16, 8, 60, 320


def outset_of(completed, *, critical=()):
    """Return the outset of a gate whose baseline completed so many of 60 trials in each scene."""
    tiers = tuple("critical" if i in critical else "supporting" for i in range(len(completed)))
    return Outset(
        strata=tuple((f"s{i:02}", ()) for i in range(len(completed))),
        seen=tuple(SceneCounts(counts=np.array([STARTS - k, k])) for k in completed),
        rules=TrialRules(tiers=tiers),
        budget=20 * len(completed),
        starts=STARTS,
        known=True,
    )


def test_the_information_of_a_trial_is_its_divergence_and_walds_bound_follows():
    (item,) = items_of(outset_of([30]), 0.2)
    # By hand: success .5 and .3.
    divergence = 0.3 * log(0.3 / 0.5) + 0.7 * log(0.7 / 0.5)
    assert (item.success, item.worse) == pytest.approx((0.5, 0.3), abs=1e-6)
    assert item.information == pytest.approx(divergence, rel=1e-4)
    assert item.alone == pytest.approx(log(100.0) / divergence, rel=1e-4)


def test_what_is_always_or_never_completed_tells_nothing_and_a_half_tells_most():
    items = items_of(outset_of([60, 30, 57, 0]), 0.1)
    assert [item.stratum[0] for item in items][:2] == ["s01", "s02"]
    assert [item.tells for item in items] == [True, True, False, False]


def test_a_baseline_that_never_failed_tells_little_and_breaks_nothing():
    items = items_of(outset_of([60, 60]), 0.1)
    assert all(0.0 < item.alone <= inf for item in items)


def test_the_trials_of_a_rung_have_its_rate_at_the_end_of_the_course():
    counts = rung_counts(0.19, 4)
    assert counts.counts[-1] == 190
    assert counts.counts.sum() == pytest.approx(1000, abs=3)


def test_a_proposal_costs_as_much_finds_the_drop_sooner_and_keeps_critical_scenes():
    outset = outset_of([60] * 6 + [57, 55], critical={0})
    rungs = [("ladder@1", rung_counts(0.7, 1)), ("ladder@2", rung_counts(0.4, 1))]
    items = items_of(outset, 0.1, rungs)
    found = propose(outset, items, 0.1)
    names = {item.stratum[0] for item in found.items}
    assert {"s00", "s06", "s07", "ladder@1", "ladder@2"} <= names
    assert {item.stratum[0] for item in found.left_out} == {f"s{i:02}" for i in range(8)} - names
    assert found.rounds * len(found.items) <= outset.budget
    assert found.starts * len(found.items) <= STARTS * 8
    assert found.proposed.worse.trials < 0.8 * found.today.worse.trials
    assert found.proposed.worse.regressed >= 0.95
    assert found.proposed.equal.passed >= 0.95


def test_where_all_scenes_are_alike_nothing_is_proposed_that_is_slower():
    outset = outset_of([50, 50, 50, 50])
    assert propose(outset, items_of(outset, 0.1), 0.1) is None


def passes_at_max_drop(known, rng):
    """Return how often gates pass a policy that is worse by `max_drop` than the true .95."""
    bets = make_bets(known, np.ones(CHOSEN, dtype=np.intp), max_drop=0.1, tolerate=0.02)
    reference = Reference(means=known.mean(axis=-1), starts=STARTS, bets=bets).fresh()
    order = np.argsort(rng.random((GATES, CHOSEN * STARTS)), axis=-1)[:, :BUDGET]
    trials = DrawnTrials(
        scenes=order // STARTS,
        candidate=(rng.random(order.shape) < 0.95 - 0.1).astype(float),
        baseline=np.take_along_axis(known.reshape(GATES, -1), order, axis=-1),
    )
    rules = TrialRules(tiers=("supporting",) * CHOSEN)
    return [found.word for found in settle_all(reference, trials, rules)].count("PASS") / GATES


def test_a_baseline_saved_anew_keeps_the_error_that_its_old_results_would_break():
    """Sixteen equal scenes: what is chosen was unlucky, and is not when it is run anew."""
    rng = np.random.default_rng(1)
    rows = (rng.random((GATES, SCENES, STARTS)) < 0.95).astype(float)
    chosen = [
        [
            int(item.stratum[0][1:])
            for item in items_of(outset_of(each.sum(axis=-1).astype(int)), 0.1)[:CHOSEN]
        ]
        for each in rows
    ]
    old = np.take_along_axis(rows, np.array(chosen)[:, :, None], axis=1)
    anew = (rng.random(old.shape) < 0.95).astype(float)
    assert old.mean() < 0.94
    error = 3.0 * (0.05 * 0.95 / GATES) ** 0.5
    assert passes_at_max_drop(old, rng) > 0.05 + error
    assert passes_at_max_drop(anew, rng) <= 0.05 + error
