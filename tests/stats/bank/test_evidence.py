"""Evidence is fair, the same however it is fed, and never gains by what is missing."""

from __future__ import annotations

from itertools import permutations, product
from math import inf, nan

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from nw_eval.stats.bank import Bank, Evidence, Margins, Values, over_rounds

shares = st.sampled_from([0.0, 0.25, 1 / 3, 0.5, 2 / 3, 0.8, 1.0])
shapes = st.sampled_from([(1, 1), (1, 2), (1, 4), (2, 2), (2, 3), (3, 2), (3, 3)])
panels = shapes.flatmap(lambda shape: arrays(np.float64, (2, *shape), elements=shares))


def all_orders(scores: np.ndarray) -> np.ndarray:
    """Scores of shape (S, M) in every order of the starts of every scene, (orders, M, S)."""
    scenes, starts = scores.shape
    orders = np.array(list(product(permutations(range(starts)), repeat=scenes)))
    return np.take_along_axis(scores[None], orders, axis=2).swapaxes(1, 2)


def campaign(rounds: int, scenes: int, seed: int = 0) -> tuple[Bank, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    baseline = rng.integers(2, 6, (scenes, 2 * rounds)) / 5
    candidate = rng.integers(0, 6, (rounds, scenes)) / 5
    return Bank.of(baseline), candidate, baseline[:, :rounds].T.copy()


def same(one: Values, other: Values) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


@settings(deadline=None, max_examples=80)
@given(panels)
def test_at_the_margin_the_mean_over_all_orders_is_at_most_one(panel: np.ndarray) -> None:
    better, worse = sorted(panel, key=lambda scores: -scores.mean(axis=1).mean())
    drop = float(better.mean(axis=1).mean() - worse.mean(axis=1).mean())
    if drop >= 1.0:
        return
    margins = Margins(max_drop=drop, tolerate=drop, scene_drop=drop)
    rounds = over_rounds(Bank.of(better), all_orders(worse), all_orders(better), margins)
    for values in rounds:
        assert values.passed.mean() <= 1.0 + 1e-9
        assert values.regressed.mean() <= 1.0 + 1e-9
        # A scene that dropped more than the mean of all is beyond its margin.
        within = better.mean(axis=1) - worse.mean(axis=1) <= drop + 1e-12
        assert (values.scenes.mean(axis=0)[within] <= 1.0 + 1e-9).all()


@settings(deadline=None, max_examples=40)
@given(panels)
def test_a_better_trial_helps_to_pass_and_never_convicts(panel: np.ndarray) -> None:
    bank, better = Bank.of(panel[1]), panel.max(axis=0).T
    baseline = panel[1].T
    worse_rounds = over_rounds(bank, panel[0].T, baseline, Margins())
    better_rounds = over_rounds(bank, better, baseline, Margins())
    for worse, best in zip(worse_rounds, better_rounds, strict=True):
        assert best.passed >= worse.passed * (1 - 1e-9)
        assert best.regressed * (1 - 1e-9) <= worse.regressed
        assert (best.scenes * (1 - 1e-9) <= worse.scenes).all()


def test_round_by_round_and_all_at_once_are_the_same_bits() -> None:
    bank, candidate, baseline = campaign(rounds=12, scenes=13)
    at_once = over_rounds(bank, candidate, baseline, Margins())
    evidence = Evidence.before(bank, Margins())
    for r, expected in enumerate(at_once):
        evidence = evidence.after(candidate[r], baseline[r])
        assert same(evidence.values, expected)


def test_neither_the_layout_of_memory_nor_other_panels_change_a_bit() -> None:
    bank, candidate, baseline = campaign(rounds=12, scenes=13)
    expected = over_rounds(bank, candidate, baseline, Margins())
    three = (
        np.stack([candidate[::-1], candidate, 1.0 - candidate]),
        np.stack([baseline[::-1], baseline, baseline]),
    )
    for lay in (np.ascontiguousarray, np.asfortranarray):
        alone = over_rounds(bank, lay(candidate), lay(baseline), Margins())
        stacked = over_rounds(bank, lay(three[0]), lay(three[1]), Margins())
        for values, one, together in zip(expected, alone, stacked, strict=True):
            assert same(values, one)
            assert same(values, Values(*(part[1] for part in together)))


def test_the_order_of_rounds_matters_to_a_bank_but_not_to_fresh_starts() -> None:
    known, candidate, baseline = campaign(rounds=8, scenes=5)
    fresh = Bank(means=known.means)
    for bank, equal in ((fresh, True), (known, False)):
        forth = over_rounds(bank, candidate, baseline, Margins())[-1]
        back = over_rounds(bank, candidate[::-1], baseline[::-1], Margins())[-1]
        assert np.allclose(forth.passed, back.passed, rtol=1e-9, atol=0.0) is equal


def test_a_missing_trial_counts_against_either_verdict() -> None:
    bank, candidate, baseline = campaign(rounds=4, scenes=3)
    gap, failure, success = candidate.copy(), candidate.copy(), candidate.copy()
    gap[1, 2], failure[1, 2], success[1, 2] = nan, 0.0, 1.0
    found = over_rounds(bank, gap, baseline, Margins())[-1]
    at_worst = over_rounds(bank, failure, baseline, Margins())[-1]
    at_best = over_rounds(bank, success, baseline, Margins())[-1]
    assert np.array_equal(found.passed, at_worst.passed)
    assert np.array_equal(found.regressed, at_best.regressed)
    assert np.array_equal(found.scenes, at_best.scenes)
    assert found.passed < at_best.passed
    assert found.regressed < at_worst.regressed


def test_trials_that_are_all_missing_decide_nothing() -> None:
    bank, _, baseline = campaign(rounds=20, scenes=6)
    for values in over_rounds(bank, np.full((20, 6), nan), baseline, Margins()):
        assert values.passed < 1.0
        assert values.regressed < 1.0
        assert (values.scenes < 1.0).all()


def test_a_panel_that_is_wholly_known_leaves_no_doubt() -> None:
    ones = np.ones((4, 1))
    bank = Bank(means=np.ones(1), starts=4)
    # Of four starts a drop of .10 leaves 3.6 successes: after four of them it is impossible.
    found = [float(values.passed) for values in over_rounds(bank, ones, ones, Margins())]
    assert max(found[:3]) < 2.0
    assert found[3] == inf
    # A drop of at most .02 leaves at least 3.92: with one failure of four it is, too.
    failed = over_rounds(bank, np.array([[0.0], [1.0], [1.0], [1.0]]), ones, Margins())
    assert [bool(np.isinf(values.regressed)) for values in failed] == [True] * 4
    assert [bool(np.isinf(values.scenes[0])) for values in failed] == [True] * 4


def test_a_null_that_is_just_true_is_never_called_impossible_by_rounding() -> None:
    # Thirds and tenths: sums of a just true null are off by some 1e-15, on either side.
    rng = np.random.default_rng(3)
    for _ in range(40):
        scores = rng.choice([0.1, 0.2, 0.3, 1 / 3, 2 / 3, 0.7, 1.0], (5, 30))
        exact = Margins(max_drop=0.0, tolerate=0.0, scene_drop=0.0)
        for values in over_rounds(Bank.of(scores), scores.T, scores.T, exact):
            assert np.isfinite(values.passed)
            assert np.isfinite(values.regressed)
            assert np.isfinite(values.scenes).all()


def test_rounding_wins_no_bet_where_a_null_leaves_only_zeros() -> None:
    # After the first of these starts only z_min is left, to a double's precision: a win of 1e-16
    # must not be paid at odds of 1e-16.
    for hundredths in range(1, 100, 2):
        baseline = np.array([[hundredths / 100, 1.0, 1.0]])
        candidate = np.array([[hundredths / 170, 0.0, 0.0]])
        margins = Margins(max_drop=float(baseline.mean() - candidate.mean()))
        drawn = all_orders(candidate), all_orders(baseline)
        for values in over_rounds(Bank.of(baseline), *drawn, margins):
            assert values.passed.mean() == pytest.approx(1.0, abs=1e-9)


def test_overwhelming_evidence_stays_a_number() -> None:
    bank = Bank(means=np.ones(300))
    zeros, ones = np.zeros((30, 300)), np.ones((30, 300))
    last = over_rounds(bank, zeros, ones, Margins(tolerate=0.0))[-1]
    assert 1e100 < last.regressed < inf
    assert last.passed == 0.0


@pytest.mark.parametrize("wrong", [-0.1, 1.1, inf])
def test_a_success_outside_the_unit_interval_is_refused(wrong: float) -> None:
    bank = Bank(means=np.array([0.5]))
    with pytest.raises(ValueError, match="is not between 0 and 1"):
        Evidence.before(bank, Margins()).after(np.array([wrong]), np.array([0.5]))


def test_a_baseline_without_a_result_is_refused() -> None:
    with pytest.raises(ValueError, match="success nan is not between 0 and 1"):
        Bank.of(np.array([[1.0, nan]]))
    bank = Bank(means=np.array([0.5]))
    with pytest.raises(ValueError, match="success nan is not between 0 and 1"):
        Evidence.before(bank, Margins()).after(np.array([1.0]), np.array([nan]))


def test_more_rounds_than_starts_are_refused() -> None:
    ones = np.ones((3, 1))
    with pytest.raises(ValueError, match="round 3 of a bank with 2 starts a scene"):
        over_rounds(Bank.of(np.ones((1, 2))), ones, ones, Margins())


@pytest.mark.parametrize("shape", [(2,), (4,), (1,)])
def test_a_round_of_other_scenes_than_the_banks_is_refused(shape: tuple[int, ...]) -> None:
    bank = Bank(means=np.ones(3))
    with pytest.raises(ValueError, match="with 3 scenes in the bank"):
        Evidence.before(bank, Margins()).after(np.ones(shape), np.ones(shape))
    with pytest.raises(ValueError, match="against"):
        over_rounds(bank, np.ones((2, 3)), np.ones((1, 3)), Margins())


def test_a_bank_needs_a_scene_and_a_start() -> None:
    with pytest.raises(ValueError, match="one scene at least"):
        Bank(means=np.zeros(0))
    with pytest.raises(ValueError, match="one at least"):
        Bank(means=np.ones(1), starts=0)


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
def test_margins_that_contradict_themselves_are_refused(drops: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="not within 0 to 1"):
        Margins(**drops)


def test_z_has_the_candidates_mean_over_the_panel_and_stays_within_its_ends() -> None:
    rng = np.random.default_rng(5)
    baseline, candidate = rng.random((2, 4, 50))
    bank = Bank.of(baseline)
    for beta in (0.0, 0.5):
        z = bank.adjusted(candidate.T, baseline.T, beta)
        assert z.mean() == pytest.approx(candidate.mean(), rel=1e-12)
        assert z.min() >= bank.least(beta)
        assert z.max() <= bank.most(beta)
