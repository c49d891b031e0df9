"""The method's published figures, to the digits that were published."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
import pytest

from nw_eval.stats.bank import Bank, Margins, over_rounds

PERFECT = Bank(means=np.ones(1))
HURDLES = Bank(
    means=np.array([0.525, 0.9, *[0.933] * 3, *[0.95] * 3, *[0.967] * 2, *[1.0] * 6]), starts=60
)


def column(values: list[float]) -> np.ndarray:
    """Rounds of a single scene."""
    return np.array(values, dtype=np.float64)[:, None]


def test_perfect_trials_against_a_perfect_baseline_grow_the_evidence_for_pass() -> None:
    ones = np.ones((40, 1))
    found = [float(v.passed) for v in over_rounds(PERFECT, ones, ones, Margins(max_drop=0.10))]
    assert [round(found[n - 1], 4) for n in (1, 10, 20, 30, 40)] == [
        1.0789,
        2.1732,
        4.8890,
        11.3300,
        26.9165,
    ]


@pytest.mark.parametrize(("max_drop", "trials"), [(0.05, 76), (0.10, 37), (0.15, 24), (0.20, 18)])
def test_the_fewest_trials_that_pass_are_as_published(max_drop: float, trials: int) -> None:
    ones = np.ones((trials, 1))
    found = [float(v.passed) for v in over_rounds(PERFECT, ones, ones, Margins(max_drop=max_drop))]
    assert found[-2] < 20.0 <= found[-1]


@pytest.mark.parametrize(
    ("scores", "evidence"),
    [([0.0], 8.8871), ([0.0, 0.0], 221.7623), ([1.0, 0.0], 4.5427), ([0.5], 4.8631)],
)
def test_failures_grow_the_evidence_for_regressed(scores: list[float], evidence: float) -> None:
    ones = np.ones((len(scores), 1))
    last = over_rounds(PERFECT, column(scores), ones, Margins(tolerate=0.02))[-1]
    assert round(float(last.regressed), 4) == evidence


@pytest.mark.parametrize(
    ("scores", "evidence"),
    [
        ([0.0], 3.7900),
        ([0.0, 0.0], 20.3905),
        ([0.0, 0.0, 0.0], 136.1127),
        ([1.0, 0.0, 0.0], 7.5325),
    ],
)
def test_failures_grow_the_evidence_against_a_scene(scores: list[float], evidence: float) -> None:
    ones = np.ones((len(scores), 1))
    last = over_rounds(PERFECT, column(scores), ones, Margins(scene_drop=0.10))[-1]
    assert round(float(last.scenes[0]), 4) == evidence


def test_over_all_orders_of_a_panel_at_the_margin_evidence_is_fair() -> None:
    baseline = np.array([[1.0, 1.0, 1.0, 0.5], [1.0, 0.5, 1.0, 0.0]])
    candidate = np.array([[1.0, 0.5, 1.0, 0.5], [0.5, 0.5, 1.0, 0.0]])
    orders = np.array(list(product(permutations(range(4)), repeat=2)))  # (576, S, M)

    def drawn(scores: np.ndarray) -> np.ndarray:
        return np.take_along_axis(scores[None], orders, axis=2).swapaxes(1, 2)[:, :3]

    rounds = over_rounds(
        Bank.of(baseline),
        drawn(candidate),
        drawn(baseline),
        Margins(max_drop=0.125, tolerate=0.125),
    )
    passed = np.array([values.passed for values in rounds])
    regressed = np.array([values.regressed for values in rounds])
    assert passed.shape == (3, 576)
    assert passed.mean(axis=1).round(6).tolist() == [1.0, 0.996627, 0.985715]
    assert regressed.mean(axis=1).round(6).tolist() == [1.0, 0.997978, 0.990997]
    assert round(float((passed.max(axis=0) >= 2.0).mean()), 3) == 0.083
    assert round(float((regressed.max(axis=0) >= 2.0).mean()), 3) == 0.028


def test_sixteen_scenes_without_a_failure_pass_in_two_rounds() -> None:
    ones = np.ones((4, 16))
    found = over_rounds(HURDLES, ones, ones, Margins(max_drop=0.10))
    assert [round(float(values.passed), 4) for values in found] == [
        6.1569,
        46.9510,
        426.7381,
        4481.1625,
    ]


def test_sixteen_scenes_that_get_half_way_are_convicted_in_one_round() -> None:
    found = over_rounds(HURDLES, np.full((2, 16), 0.5), np.ones((2, 16)), Margins(tolerate=0.02))
    assert round(float(found[0].regressed), 4) == 406.6411
    assert round(float(found[1].regressed), 2) == 1459218.35
