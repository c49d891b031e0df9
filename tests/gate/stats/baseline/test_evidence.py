"""Evidence is what its formula says, fair, and never gains by what is missing."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from itertools import permutations
from math import inf, nan, sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from nw_gate.stats.baseline.evidence import DOWN, UP, Bets, Margins, Reference, along
from nw_gate.stats.baseline.trials import DrawnTrials, Looks, above_at, below_at, looks

PERFECT = Reference(means=np.ones(1))
shares = st.sampled_from([0.0, 0.25, 1 / 3, 0.5, 2 / 3, 0.8, 1.0])
shapes = st.sampled_from([(1, 1), (1, 2), (1, 4), (2, 2), (2, 3), (3, 2)])
panels = shapes.flatmap(lambda shape: arrays(np.float64, (2, *shape), elements=shares))
eighths = st.integers(0, 8).map(lambda number: number / 8)


def trials_of(order: np.ndarray, baseline: np.ndarray, candidate: np.ndarray) -> DrawnTrials:
    """Trials of scores of shape (S, M), drawn in an order of places in them, shape (..., T)."""
    scenes, starts = order // baseline.shape[1], order % baseline.shape[1]
    return DrawnTrials(
        scenes=scenes, candidate=candidate[scenes, starts], baseline=baseline[scenes, starts]
    )


def in_all_orders(baseline: np.ndarray, candidate: np.ndarray) -> DrawnTrials:
    """All pairs of a scene and a start, in every order."""
    return trials_of(np.array(list(permutations(range(baseline.size)))), baseline, candidate)


def in_one_scene(candidate: list[float], baseline: float = 1.0) -> DrawnTrials:
    scores = np.array([candidate])
    return trials_of(np.arange(len(candidate)), np.full_like(scores, baseline), scores)


def campaign(seed: int = 0, scenes: int = 13) -> tuple[Reference, DrawnTrials]:
    """Half of the pairs of a scene and one of 24 starts, in random order."""
    rng = np.random.default_rng(seed)
    baseline = rng.integers(2, 6, (scenes, 24)) / 5
    candidate = rng.integers(0, 6, (scenes, 24)) / 5
    order = rng.permutation(baseline.size)[: baseline.size // 2]
    return Reference.of(baseline), trials_of(order, baseline, candidate)


def same(one: Looks, other: Looks) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


def wealth_of(values: list[float], null: float, size: float, bets: Bets) -> list[float]:
    """E after each draw, by its formula in exact numbers: one draw after another."""
    mean, drawn, accounts = Fraction(null), list[Fraction](), [Fraction(1)] * len(bets.shares)
    found = list[float]()
    for y in map(Fraction, values):
        rest = mean
        if size < inf:
            rest = (int(size) * mean - sum(drawn)) / (int(size) - len(drawn))
        drawn.append(y)
        if size < inf and int(size) * mean < sum(drawn):
            found.append(inf)
            continue
        if rest > 0:  # Else nothing but zeros is left, and no bet is won or lost.
            accounts = [
                account * (1 + Fraction(share) * (y - rest) / rest)
                for account, share in zip(accounts, bets.shares, strict=True)
            ]
        weighed = zip(map(Fraction, bets.weights), accounts, strict=True)
        found.append(float(sum(weight * account for weight, account in weighed)))
    return found


@settings(deadline=None, max_examples=100)
@given(
    st.lists(st.lists(eighths, min_size=9, max_size=9), min_size=1, max_size=3),
    st.integers(1, 12).map(lambda number: number / 8),
    st.sampled_from([9, 10, 16, inf]),
    st.sampled_from([UP, DOWN]),
)
def test_the_wealth_of_all_draws_at_once_is_that_of_the_formula_draw_by_draw(
    boxes, null, size, bets
):
    found = along(np.array(boxes), np.full(len(boxes), null), size, bets)
    for box, evidence in zip(boxes, found, strict=True):
        assert evidence == pytest.approx(wealth_of(box, null, size, bets), rel=1e-9)


def test_perfect_trials_against_a_perfect_baseline_grow_the_evidence_for_pass():
    found = looks(PERFECT, in_one_scene([1.0] * 40), Margins(max_drop=0.10)).passed
    published = [1.0789, 2.1732, 4.8890, 11.3300, 26.9165]
    assert found[[0, 9, 19, 29, 39]].round(4).tolist() == published


@pytest.mark.parametrize(("max_drop", "trials"), [(0.05, 76), (0.10, 37), (0.15, 24), (0.20, 18)])
def test_the_fewest_trials_that_pass_are_as_published(max_drop, trials):
    found = looks(PERFECT, in_one_scene([1.0] * trials), Margins(max_drop=max_drop)).passed
    assert found[-2] < 20.0 <= found[-1]


@pytest.mark.parametrize(
    ("scores", "evidence"),
    [([0.0], 8.8871), ([0.0, 0.0], 221.7623), ([1.0, 0.0], 4.5427), ([0.5], 4.8631)],
)
def test_failures_grow_the_evidence_for_regressed(scores, evidence):
    found = looks(PERFECT, in_one_scene(scores), Margins(tolerate=0.02)).regressed
    assert found[-1].round(4) == evidence


@pytest.mark.parametrize(
    ("scores", "evidence"),
    [
        ([0.0], 3.7900),
        ([0.0, 0.0], 20.3905),
        ([0.0, 0.0, 0.0], 136.1127),
        ([1.0, 0.0, 0.0], 7.5325),
    ],
)
def test_failures_grow_the_evidence_against_a_scene(scores, evidence):
    found = looks(PERFECT, in_one_scene(scores), Margins(scene_drop=0.10)).own
    assert found[-1].round(4) == evidence


def test_a_scenes_evidence_is_of_its_own_trials_whatever_comes_between():
    reference, trials = campaign()
    found = looks(reference, trials, Margins()).own
    for scene in range(13):
        own = np.flatnonzero(trials.scenes == scene)
        alone = replace(trials.at(own.tolist()), scenes=np.zeros(len(own), dtype=np.intp))
        one = replace(reference, means=reference.means[[scene]])
        assert np.array_equal(looks(one, alone, Margins()).own, found[own])


@settings(deadline=None, max_examples=80)
@given(panels)
def test_at_the_margin_the_mean_over_all_orders_is_at_most_one(panel):
    better, worse = sorted(panel, key=lambda scores: -scores.mean())
    drop = float(better.mean() - worse.mean())
    if drop >= 1.0:
        return
    drawn = in_all_orders(better, worse)
    margins = Margins(max_drop=drop, tolerate=drop, scene_drop=drop)
    found = looks(Reference.of(better), drawn, margins)
    for evidence in (found.passed, found.regressed):
        assert evidence.mean(axis=0).max() <= 1.0 + 1e-9
    # A scene that dropped more than the mean of all is beyond its margin.
    within = np.flatnonzero(better.mean(axis=1) - worse.mean(axis=1) <= drop + 1e-12)
    for scene in within:
        own = found.own[drawn.scenes == scene].reshape(len(drawn.scenes), -1)  # (orders, M)
        assert own.mean(axis=0).max() <= 1.0 + 1e-9


def test_as_long_as_nothing_is_all_but_used_up_the_mean_over_all_orders_is_one():
    baseline = np.array([[1.0, 1.0, 0.5], [1.0, 0.5, 0.0]])
    candidate = np.array([[1.0, 0.5, 0.5], [0.5, 0.5, 0.0]])
    drop = float(baseline.mean() - candidate.mean())
    drawn = in_all_orders(baseline, candidate)
    found = looks(
        Reference.of(baseline), drawn, Margins(max_drop=drop, tolerate=drop, scene_drop=drop)
    )
    for evidence in (found.passed, found.regressed):
        assert evidence[:, :3].mean(axis=0) == pytest.approx(1.0, abs=1e-9)
    for scene in (0, 1):
        first = drawn.scenes[:, 0] == scene
        assert found.own[first, 0].mean() == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("starts", [3, inf])
@pytest.mark.parametrize("seed", range(12))
def test_over_all_orders_evidence_seldom_convinces_of_what_is_not_so(starts, seed):
    rng = np.random.default_rng(seed)
    baseline, candidate = rng.choice([0.0, 0.5, 1.0, 1.0], (2, 2, 3))
    if not candidate.mean() <= baseline.mean():
        baseline, candidate = candidate, baseline
    drop = float(baseline.mean() - candidate.mean())
    reference = Reference(means=baseline.mean(axis=1), starts=starts)
    drawn = in_all_orders(baseline, candidate)
    assert drawn.scenes.shape == (720, 6)
    found = looks(reference, drawn, Margins(max_drop=drop, tolerate=drop))
    for evidence in (found.passed, found.regressed):
        assert evidence.mean(axis=0).max() <= 1.0 + 1e-9
        highest = evidence.max(axis=1)
        for least in (1.2, 1.5, 2.0, 4.0, 20.0):
            assert (highest >= least).mean() <= 1.0 / least


def panel_of(kind: str, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A baseline and a worse candidate, (6, 24): success a share of five waypoints."""
    baseline = (rng.random((6, 24, 5)) < 0.97).cumprod(-1).sum(-1) / 5
    candidate = baseline.copy()
    if kind == "concentrated":
        candidate[0] = 0.0
    elif kind == "rare":
        candidate[:, :3] = 0.0
    elif kind == "unrelated":
        candidate = (rng.random((6, 24, 5)) < 0.92).cumprod(-1).sum(-1) / 5
    else:
        candidate = np.maximum(baseline - 0.2, 0.0)
    return baseline, candidate


@pytest.mark.parametrize("kind", ["concentrated", "rare", "unrelated", "even"])
def test_at_the_margin_evidence_ever_convinces_no_more_often_than_it_promises(kind):
    rng, alpha, gates = np.random.default_rng(20262), 0.05, 1500
    baseline, candidate = panel_of(kind, rng)
    order = np.argsort(rng.random((gates, baseline.size)), axis=1)[:, :96]
    drop = float(baseline.mean() - candidate.mean())
    trials = trials_of(order, baseline, candidate)
    found = looks(Reference.of(baseline), trials, Margins(max_drop=drop, tolerate=drop))
    most = alpha + 3 * sqrt(alpha * (1 - alpha) / gates)
    for evidence in (found.passed, found.regressed):
        # Looking after every trial, whatever the scenes would say.
        convinced = (evidence.max(axis=1) >= 1 / alpha).mean()
        assert convinced <= most


@settings(deadline=None, max_examples=40)
@given(panels, st.randoms(use_true_random=False))
def test_a_better_trial_helps_to_pass_and_never_convicts(panel, rng):
    order = np.array(rng.sample(range(panel[0].size), panel[0].size))
    reference = Reference.of(panel[1])
    worse = looks(reference, trials_of(order, panel[1], panel[0]), Margins())
    better = looks(reference, trials_of(order, panel[1], panel.max(axis=0)), Margins())
    assert (better.passed >= worse.passed * (1 - 1e-9)).all()
    assert (better.regressed * (1 - 1e-9) <= worse.regressed).all()
    assert (better.own * (1 - 1e-9) <= worse.own).all()


@pytest.mark.parametrize("count", [1, 2, 50, 155])
def test_trials_that_come_later_change_no_bit_of_the_looks_before(count):
    reference, trials = campaign()
    every = looks(reference, trials, Margins())
    first = looks(reference, trials.at(range(count)), Margins())
    assert same(first, Looks(*(part[:count] for part in every)))


@pytest.mark.parametrize("lay", [np.ascontiguousarray, np.asfortranarray])
def test_neither_the_layout_of_memory_nor_other_gates_change_a_bit(lay):
    reference, trials = campaign()
    expected = looks(reference, trials, Margins())
    three = DrawnTrials(
        scenes=lay(np.stack([trials.scenes[::-1], trials.scenes, trials.scenes])),
        candidate=lay(np.stack([trials.candidate, trials.candidate, 1.0 - trials.candidate])),
        baseline=lay(np.stack([trials.baseline[::-1], trials.baseline, trials.baseline])),
    )
    means = lay(np.stack([reference.means[::-1], reference.means, reference.means]))
    for which in (reference, replace(reference, means=means)):
        together = looks(which, three, Margins())
        assert same(expected, Looks(*(part[1] for part in together)))


def test_the_order_of_trials_matters_to_a_baseline_but_not_to_fresh_starts():
    known, trials = campaign(scenes=5)
    back = trials.at(range(len(trials.scenes) - 1, -1, -1))
    for reference, equal in ((known.fresh(), True), (known, False)):
        one, other = (looks(reference, drawn, Margins()).passed[-1] for drawn in (trials, back))
        assert np.isclose(one, other, rtol=1e-9, atol=0.0) == equal


@pytest.mark.parametrize("paired", [False, True])
def test_a_missing_trial_counts_as_a_failure_for_pass_and_as_a_success_against_it(paired):
    reference, trials = campaign(scenes=3)
    reference = Reference.control(3) if paired else reference

    def scoring(success: float) -> Looks:
        candidate = np.where(np.arange(36) == 7, success, trials.candidate)
        return looks(reference, replace(trials, candidate=candidate), Margins())

    missing, failed, succeeded = scoring(nan), scoring(0.0), scoring(1.0)
    assert np.array_equal(missing.passed, failed.passed)
    assert np.array_equal(missing.regressed, succeeded.regressed)
    assert np.array_equal(missing.own, succeeded.own)
    assert missing.passed[7] < succeeded.passed[7]
    assert missing.regressed[7] < failed.regressed[7]
    assert missing.own[7] < failed.own[7]


def test_trials_that_are_all_missing_decide_nothing():
    reference, trials = campaign(scenes=6)
    gone = replace(trials, candidate=np.full(len(trials.scenes), nan))
    found = looks(reference, gone, Margins())
    for evidence in found:
        assert evidence.max() < 1.0


def test_what_is_true_of_the_panel_is_certain_at_its_end_and_of_fresh_starts_never():
    baseline = np.array([[1.0, 1.0, 0.5], [1.0, 0.5, 0.0]])
    candidate = np.array([[1.0, 0.5, 0.5], [0.5, 0.5, 0.0]])
    drop, drawn = float(baseline.mean() - candidate.mean()), in_all_orders(baseline, candidate)
    margins, reference = Margins(max_drop=drop + 0.01, tolerate=drop - 0.01), Reference.of(baseline)
    panel = looks(reference, drawn, margins)
    assert np.isinf(panel.passed[:, -1]).all()
    assert np.isinf(panel.regressed[:, -1]).all()
    fresh = looks(reference.fresh(), drawn, margins)
    assert max(fresh.passed.max(), fresh.regressed.max()) < 10.0


def test_a_claim_is_certain_as_soon_as_what_is_left_cannot_refute_it():
    reference = Reference(means=np.ones(1), starts=4)
    # Of four starts a drop of .10 leaves 3.6 successes: after four of them it is impossible.
    found = looks(reference, in_one_scene([1.0] * 4), Margins()).passed
    assert found[:3].max() < 2.0
    assert found[3] == inf
    # A drop of at most .02 leaves at least 3.92: with one failure of four it is, too.
    failed = looks(reference, in_one_scene([0.0, 1.0, 1.0, 1.0]), Margins())
    assert np.isinf(failed.regressed).all()
    assert np.isinf(failed.own).all()


def test_a_baseline_that_nowhere_scores_max_drop_cannot_be_undercut_by_so_much():
    reference = Reference(means=np.array([0.05, 0.09]))
    trials = trials_of(np.arange(4), np.zeros((2, 2)), np.zeros((2, 2)))
    assert np.isinf(looks(reference, trials, Margins(max_drop=0.10)).passed).all()
    assert np.isfinite(looks(reference, trials, Margins(max_drop=0.09)).passed).all()


def test_a_null_that_is_just_true_is_never_called_impossible_by_rounding():
    # Thirds and tenths: sums of a just true null are off by some 1e-15, on either side.
    rng = np.random.default_rng(3)
    exact = Margins(max_drop=0.0, tolerate=0.0, scene_drop=0.0)
    for _ in range(40):
        scores = rng.choice([0.1, 0.2, 0.3, 1 / 3, 2 / 3, 0.7, 1.0], (5, 30))
        trials = trials_of(rng.permutation(scores.size), scores, scores)
        for evidence in looks(Reference.of(scores), trials, exact):
            assert np.isfinite(evidence).all()


def test_rounding_wins_no_bet_where_a_null_leaves_only_zeros():
    # After the first of these starts only z_min is left, to a double's precision: a win of 1e-16
    # must not be paid at odds of 1e-16.
    for hundredths in range(1, 100, 2):
        baseline = np.array([[hundredths / 100, 1.0, 1.0]])
        candidate = np.array([[hundredths / 170, 0.0, 0.0]])
        margins = Margins(max_drop=float(baseline.mean() - candidate.mean()))
        found = looks(Reference.of(baseline), in_all_orders(baseline, candidate), margins)
        assert found.passed.mean(axis=0) == pytest.approx(1.0, abs=1e-9)


def test_overwhelming_evidence_stays_a_number():
    reference, order = Reference(means=np.ones(300)), np.arange(9000)
    trials = trials_of(order, np.ones((300, 30)), np.zeros((300, 30)))
    found = looks(reference, trials, Margins(tolerate=0.0))
    assert 1e100 < found.regressed[-1] < inf
    assert found.passed[-1] == 0.0
    assert not np.isnan(found.regressed).any()


def test_beside_a_control_only_the_difference_of_the_two_arms_counts():
    control = Reference.control(1)
    ties = looks(control, in_one_scene([0.3] * 40, baseline=0.3), Margins(max_drop=0.10))
    perfect = looks(PERFECT, in_one_scene([1.0] * 40), Margins(max_drop=0.10))
    assert ties.passed == pytest.approx(perfect.passed)
    # z = 1 + c - a, against 1 + tolerate from above and 1 + scene_drop in the scene.
    found = looks(
        control, in_one_scene([0.25], baseline=0.75), Margins(tolerate=0.02, scene_drop=0.1)
    )
    bets = np.array([0.05, 0.1, 0.2, 0.4, 0.8])
    assert found.regressed[0] == pytest.approx(np.mean(1 + bets * (1.5 - 1.02) / 1.02))
    assert found.own[0] == pytest.approx(np.mean(1 + bets * (1.5 - 1.1) / 1.1))


def test_z_has_the_candidates_mean_over_the_panel_and_stays_within_its_ends():
    rng = np.random.default_rng(5)
    baseline, candidate = rng.random((2, 4, 50))
    reference, trials = Reference.of(baseline), trials_of(np.arange(200), baseline, candidate)
    sides = zip(
        reference.betas, above_at(reference, trials), below_at(reference, trials), strict=True
    )
    for beta, above, below in sides:
        assert above.mean() + reference.least(beta) == pytest.approx(candidate.mean(), rel=1e-12)
        assert reference.most(beta) - below.mean() == pytest.approx(candidate.mean(), rel=1e-12)
        assert min(above.min(), below.min()) >= 0.0


@pytest.mark.parametrize("wrong", [-0.1, 1.1, inf])
def test_a_success_outside_the_unit_interval_is_refused(wrong):
    for candidate, baseline in ((wrong, 1.0), (1.0, wrong)):
        with pytest.raises(ValueError, match="is not between 0 and 1"):
            in_one_scene([candidate], baseline)


def test_a_baseline_needs_a_scene_and_a_start_and_a_result_of_each():
    with pytest.raises(ValueError, match="one scene at least"):
        Reference(means=np.zeros(0))
    with pytest.raises(ValueError, match="at least one"):
        Reference(means=np.ones(1), starts=0)
    with pytest.raises(ValueError, match="success nan is not between 0 and 1"):
        Reference.of(np.array([[1.0, nan]]))


def test_more_trials_of_a_scene_than_it_has_starts_are_refused():
    ones = np.ones(3)
    trials = DrawnTrials(scenes=np.zeros(3, dtype=np.intp), candidate=ones, baseline=ones)
    with pytest.raises(ValueError, match="3 draws of 2 numbers"):
        looks(Reference(means=np.ones(2), starts=2), trials, Margins())


@pytest.mark.parametrize(
    "drops",
    [
        {"tolerate": 0.2},
        {"tolerate": -0.1},
        {"max_drop": 1.0},
        {"max_drop": nan},
        {"scene_drop": -0.1},
        {"scene_drop": nan},
    ],
)
def test_margins_that_contradict_themselves_are_refused(drops):
    with pytest.raises(ValueError, match="not within 0 to 1"):
        Margins(**drops)
