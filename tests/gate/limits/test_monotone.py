"""A curve that is not monotone is found; one that is, is not, by exact sums."""

from itertools import product
from math import comb, exp, log

import numpy as np
import pytest
from scipy.optimize import isotonic_regression
from scipy.special import betaln

from nw_gate.limits.monotone import Dip, find_dip, log_evidence
from nw_gate.limits.monotone import _log_predicted as log_predicted


@pytest.mark.parametrize("rates", [(0.5, 0.5, 0.5), (0.9, 0.9, 0.9), (1.0, 0.6, 0.2), (0.3,) * 3])
def test_the_evidence_is_at_most_1_on_average_for_every_falling_curve(rates):
    total = 0.0
    for done in product(range(5), repeat=3):
        chance = np.prod(
            [comb(4, k) * p**k * (1 - p) ** (4 - k) for k, p in zip(done, rates, strict=True)]
        )
        counts = np.array(done, float)
        total += chance * exp(log_evidence(counts, 4 - counts)) if chance else 0.0
    assert 0.0 < total <= 1.0


def test_the_best_falling_curve_is_that_of_scipy():
    rng = np.random.default_rng(3)
    for _ in range(30):
        done, missed = rng.integers(0, 7, (2, 6)).astype(float)
        tried = done + missed
        seen = tried > 0
        best = isotonic_regression(
            done[seen] / tried[seen], weights=tried[seen], increasing=False
        ).x
        with np.errstate(divide="ignore", invalid="ignore"):
            terms = done[seen] * np.log(best), missed[seen] * np.log(1 - best)
        likelihood = sum(float(np.nansum(term)) for term in terms)
        # The mixture has at least its part with a rate of its own for each rung.
        free = sum(
            betaln(d + 0.5, m + 0.5) - betaln(0.5, 0.5) for d, m in zip(done, missed, strict=True)
        )
        assert log_evidence(done, missed) >= free + log(0.2) - likelihood - 1e-9


def test_krichevsky_and_trofimov_are_those_of_the_beta_function():
    for done, missed in [(0, 0), (3, 0), (2, 5)]:
        expected = betaln(done + 0.5, missed + 0.5) - betaln(0.5, 0.5)
        assert log_predicted(done, missed) == pytest.approx(expected)


def test_a_dip_is_found_and_its_two_rungs_are_named():
    done, missed = np.array([3.0, 1, 12, 0]), np.array([0.0, 9, 0, 5])
    assert find_dip(done, missed) == Dip(easier=1, harder=2)
    assert find_dip(done[::-1], missed[::-1]) is not None


def test_few_failures_on_an_easy_rung_are_no_dip():
    assert find_dip(np.array([2.0, 1, 8, 0]), np.array([0.0, 1, 0, 5])) is None
    assert find_dip(np.zeros(4), np.zeros(4)) is None
