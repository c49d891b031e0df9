"""What is said of a simulator is no more than its policies show."""

from __future__ import annotations

from itertools import product
from math import atanh, comb, sqrt, tanh

import numpy as np
import pytest

from nw_gate.stats.agreement import (
    Measured,
    agreement,
    likely_rates,
    mmrv,
    pearson,
    perfect_simulator,
)


def measured(real, simulated, trials=10):
    return [
        Measured(
            policy=f"p{index}",
            real=x,
            real_trials=trials,
            simulated=y,
            simulated_trials=16 * trials,
        )
        for index, (x, y) in enumerate(zip(real, simulated, strict=True))
    ]


def figures(*arguments):
    return {each.name: each for each in agreement(measured(*arguments)).figures}


def test_of_the_published_table_nothing_is_said_but_the_gaps():
    """LucidSim on hurdles and on stairs, 20 trials each: two points, and any two lie in line."""
    found = agreement(
        [
            Measured(
                policy=name, real=real, real_trials=20, simulated=simulated, simulated_trials=20
            )
            for name, real, simulated in (("hurdle", 0.75, 0.75), ("stairs", 0.60, 0.85))
        ]
    )
    assert found.figures == ()
    assert found.remarks == (
        "nothing can be said of rank or correlation from 2 policies: at least 5 are needed",
    )
    hurdle, stairs = found.gaps
    # statsmodels 0.15.0, confint_proportions_2indep(15, 20, 15, 20) and (17, 20, 12, 20), newcomb.
    assert hurdle.interval == pytest.approx((-0.258674, 0.258674), abs=1e-6)
    assert stairs.interval == pytest.approx((-0.027682, 0.484690), abs=1e-6)
    assert (hurdle.value, stairs.value) == (0.0, pytest.approx(0.25))


def test_four_policies_are_too_few_and_five_are_not():
    real = [0.2, 0.5, 0.4, 0.9, 0.8]
    assert agreement(measured(real[:4], real[:4])).figures == ()
    assert {"pearson", "spearman", "mmrv"} == set(figures(real, real[::-1]))


def test_a_perfect_line_is_no_proof_the_interval_is_all_there_is():
    real = [0.2, 0.5, 0.4, 0.9, 0.8]
    found = figures(real, real)
    assert found["pearson"].value == pytest.approx(1.0)
    assert found["pearson"].interval == (-1.0, 1.0)
    assert found["mmrv"].value == 0.0
    assert found["mmrv"].interval == (0.0, 1.0)


def test_a_simulator_that_holds_all_policies_equal_has_no_correlation_and_says_why():
    found = agreement(measured([0.2, 0.5, 0.4, 0.9, 0.8], [1.0] * 5))
    assert [each.name for each in found.figures] == ["mmrv"]
    assert found.remarks == (
        "nothing can be said of correlation: all policies did equally well in the simulator",
    )


def test_the_interval_of_a_correlation_is_tukeys_on_fishers_scale():
    real, simulated = [0.1, 0.3, 0.5, 0.6, 0.8, 0.9], [0.2, 0.2, 0.6, 0.4, 0.9, 0.7]
    r = np.corrcoef(real, simulated)[0, 1]
    without = [
        atanh(np.corrcoef(real[:i] + real[i + 1 :], simulated[:i] + simulated[i + 1 :])[0, 1])
        for i in range(6)
    ]
    error = sqrt(5 / 6 * sum((z - sum(without) / 6) ** 2 for z in without))
    half = 2.5705818356363146 * error  # Student's quantile, 5 degrees of freedom.
    found = figures(real, simulated)["pearson"]
    assert found.value == pytest.approx(r)
    assert found.interval == pytest.approx((tanh(atanh(r) - half), tanh(atanh(r) + half)))


def test_an_interval_holds_its_figure_and_stays_in_range():
    rng = np.random.default_rng(5)
    for _ in range(50):
        real, simulated = rng.integers(0, 11, (2, 6)) / 10
        for name, each in figures(real, simulated).items():
            low = 0.0 if name == "mmrv" else -1.0
            assert low <= each.interval.low <= each.value <= each.interval.high <= 1.0


def test_a_perfect_simulator_of_ten_policies_shows_what_is_published():
    """gate.md, A/A sentinel, staleness, sim-to-real: MMRV .129, 95 % up to .24, Pearson .81.

    It does not say which policies. True success .3 to .9 in equal steps and 160 trials in the
    simulator give these figures; other policies give others.
    """
    found = perfect_simulator(np.linspace(0.3, 0.9, 10), np.full(10, 10), np.full(10, 160))
    assert found["mmrv"].mean == pytest.approx(0.129, abs=0.004)
    assert found["mmrv"].worst == pytest.approx(0.24, abs=0.011)  # MMRV comes in steps of .01.
    assert found["pearson"].mean == pytest.approx(0.81, abs=0.005)


def test_as_few_trials_in_the_simulator_cost_a_perfect_one_more():
    ten = np.full(10, 10)
    rates = np.random.default_rng(3).uniform(0, 1, (4000, 10))
    found = perfect_simulator(rates, ten, ten)
    assert found["mmrv"].mean == pytest.approx(0.167, abs=0.005)
    assert found["mmrv"].worst == pytest.approx(0.32, abs=0.021)
    assert found["pearson"].mean == pytest.approx(0.82, abs=0.01)


def test_the_floor_is_the_mean_over_all_outcomes_by_enumeration():
    rates, trials = (0.2, 0.5, 0.9), 2
    counts = list(product(range(trials + 1), repeat=3))
    chance = [
        np.prod([comb(2, k) * p**k * (1 - p) ** (2 - k) for k, p in zip(x, rates, strict=True)])
        for x in counts
    ]
    cases = [
        (p * q, np.array(x) / trials, np.array(y) / trials)
        for (p, x), (q, y) in product(zip(chance, counts, strict=True), repeat=2)
    ]
    expected = sum(p * mmrv(x, y) for p, x, y in cases)
    known = [(p, r) for p, x, y in cases if np.isfinite(r := pearson(x, y))]
    found = perfect_simulator(np.array(rates), np.full(3, trials), np.full(3, trials))
    assert found["mmrv"].mean == pytest.approx(expected, abs=0.02)
    wanted = sum(p * r for p, r in known) / sum(p for p, _ in known)
    assert found["pearson"].mean == pytest.approx(wanted, abs=0.03)


def test_the_floor_falls_with_trials_and_is_the_same_each_time():
    rates = np.linspace(0.3, 0.9, 10)
    few, many = (perfect_simulator(rates, np.full(10, n), np.full(10, 16 * n)) for n in (5, 200))
    assert many["mmrv"].worst < few["mmrv"].mean
    assert many["pearson"].worst > few["pearson"].mean
    assert few == perfect_simulator(rates, np.full(10, 5), np.full(10, 80))


def test_true_rates_are_guessed_from_both_kinds_of_trials_together():
    ten, many = np.full(2, 10), np.full(2, 90)
    drawn = likely_rates(np.array([0.0, 1.0]), np.array([0.5, 0.5]), ten, many)
    # Beta(1 + 45, 1 + 55) and Beta(1 + 55, 1 + 45).
    assert drawn.mean(axis=0) == pytest.approx([46 / 102, 56 / 102], abs=0.004)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"real": 1.2}, "success of policy 'a' is not between 0 and 1"),
        ({"simulated": float("nan")}, "success of policy 'a' is not between 0 and 1"),
        ({"real_trials": 0}, "policy 'a' has no trials"),
        ({"policy": "b"}, "a policy is there twice"),
    ],
)
def test_what_is_no_measurement_is_refused(change, message):
    whole = {"real": 0.5, "real_trials": 10, "simulated": 0.5, "simulated_trials": 10}
    with pytest.raises(ValueError, match=message):
        agreement([Measured(**{"policy": "a", **whole, **change}), Measured(policy="b", **whole)])


def test_impossible_rates_and_policies_without_trials_have_no_floor():
    with pytest.raises(ValueError, match="between 0 and 1"):
        perfect_simulator(np.array([1.1]), np.ones(1, int), np.ones(1, int))
    with pytest.raises(ValueError, match="without trials"):
        perfect_simulator(np.array([0.5]), np.ones(1, int), np.zeros(1, int))
