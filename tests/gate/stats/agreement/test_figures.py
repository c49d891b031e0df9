"""The figures are what others make them, and what one reckons by hand."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from nw_gate.stats.agreement import mmrv, pearson, spearman

# Robot, simulator, pearsonr and spearmanr of scipy 1.17.1; all have policies that are equal.
SCIPY = [
    (
        [0.9, 0.8, 0.75, 0.6, 0.6, 0.35, 0.2],
        [0.95, 0.7, 0.85, 0.6, 0.5, 0.5, 0.1],
        0.9279607271383369,
        0.9363636363636364,
    ),
    (
        [0.1, 0.5, 0.5, 0.5, 1.0],
        [0.0, 0.25, 0.5, 0.25, 0.75],
        0.9336995618478524,
        0.9176629354822471,
    ),
    ([0.2, 0.4, 0.9, 0.7], [0.9, 0.3, 0.1, 0.1], -0.8778664812723284, -0.9486832980505139),
]


@pytest.mark.parametrize(("real", "simulated", "r", "rho"), SCIPY)
def test_correlations_are_scipys(real, simulated, r, rho):
    real, simulated = np.array(real), np.array(simulated)
    assert pearson(real, simulated) == pytest.approx(r, rel=1e-12)
    assert spearman(real, simulated) == pytest.approx(rho, rel=1e-12)


def test_policies_that_all_do_equally_well_correlate_with_nothing():
    same, other = np.full(5, 0.1), np.linspace(0.1, 0.9, 5)
    for figure in (pearson, spearman):
        assert np.isnan(figure(same, other))
        assert np.isnan(figure(other, same))


def test_an_order_that_is_kept_violates_nothing():
    assert mmrv(np.array([0.1, 0.4, 0.9]), np.array([0.5, 0.6, 0.7])) == 0.0


def test_violations_are_charged_by_what_they_cost_on_the_robot():
    # By hand: the simulator swaps .9 and .8 (.1 each), and .3 is where it should be.
    assert mmrv(np.array([0.9, 0.8, 0.3]), np.array([0.6, 0.7, 0.1])) == pytest.approx(0.2 / 3)
    # The worst first: .9 and .3 violate each other by .6, and .8 only by .5 (against .3).
    swapped = mmrv(np.array([0.9, 0.8, 0.3]), np.array([0.2, 0.1, 0.6]))
    assert swapped == pytest.approx((0.6 + 0.5 + 0.6) / 3)


def test_of_policies_that_the_simulator_holds_equal_the_better_one_is_charged():
    assert mmrv(np.array([0.9, 0.5]), np.array([0.7, 0.7])) == pytest.approx(0.4 / 2)


def test_mmrv_is_the_definition_in_loops_for_every_order_of_four():
    real = [0.1, 0.35, 0.4, 0.9]
    for simulated in permutations([0.2, 0.2, 0.5, 0.8]):
        worst = [
            max(
                abs(real[i] - real[j]) * ((simulated[i] > simulated[j]) != (real[i] > real[j]))
                for j in range(4)
            )
            for i in range(4)
        ]
        assert mmrv(np.array(real), np.array(simulated)) == pytest.approx(sum(worst) / 4)


def test_many_sets_at_once_are_each_set_alone():
    rng = np.random.default_rng(1)
    real, simulated = rng.integers(0, 6, (2, 30, 7)) / 5
    for figure in (pearson, spearman, mmrv):
        alone = [float(figure(*pair)) for pair in zip(real, simulated, strict=True)]
        assert figure(real, simulated) == pytest.approx(alone, nan_ok=True)
