"""Functions of lanes are as near to float64 as their page says, also at the ends of their range."""

from __future__ import annotations

import math

import numba
import numpy as np
import pytest

from nw_base.simd.memory import elements, load_group, store_group
from nw_policies.executor import functions

RNG = np.random.default_rng(0)
WIDE = np.concatenate([RNG.normal(0, 3, 20_000), RNG.normal(0, 1e-3, 5_000)]).astype(np.float32)
TRUTH = {
    "exp16": (np.exp, WIDE, 2.0),
    "tanh16": (np.tanh, WIDE, 6.0),
    "sigmoid16": (lambda x: 1.0 / (1.0 + np.exp(-x)), WIDE, 3.0),
    "log16": (np.log, np.abs(WIDE) + np.float32(1e-30), 2.0),
    "softplus16": (lambda x: np.logaddexp(0.0, x), WIDE, 4.0),
    "erf16": (np.vectorize(math.erf), WIDE, 2.0),
    "expm1_16": (np.expm1, -np.abs(WIDE), 4.0),
}


def applied(name, values):
    """Return a function of sixteen lanes for all values."""
    function = getattr(functions, name)

    @numba.njit(boundscheck=False, error_model="numpy")
    def run(given, result):
        x, y = elements(given), elements(result)
        for i in range(0, len(given) - 16, 16):
            store_group(y, i, function(load_group(x, i)))

    size = -(-len(values) // 16) * 16
    given, result = np.zeros((2, size + 16), np.float32)
    given[: len(values)] = values
    run(given, result)
    return result[: len(values)]


@pytest.mark.parametrize("name", TRUTH)
def test_a_function_is_within_some_units_in_the_last_place(name):
    truth, values, most = TRUTH[name]
    wanted = truth(values.astype(np.float64))
    unit = np.spacing(np.abs(wanted).astype(np.float32)).astype(np.float64)
    assert np.max(np.abs(applied(name, values) - wanted) / unit) <= most


@pytest.mark.parametrize(("name", "truth"), [("sin16", np.sin), ("cos16", np.cos)])
def test_sine_and_cosine_hold_for_thousands_of_turns(name, truth):
    angles = np.random.default_rng(1).uniform(-1e4, 1e4, 20_000).astype(np.float32)
    assert np.max(np.abs(applied(name, angles) - truth(angles.astype(np.float64)))) < 2e-7


def test_what_is_not_a_number_stays_and_the_ends_are_the_limits():
    odd = np.array([0.0, np.inf, -np.inf, np.nan], np.float32)
    np.testing.assert_equal(applied("exp16", odd), [1.0, np.inf, 0.0, np.nan])
    np.testing.assert_equal(applied("log16", odd), [-np.inf, np.inf, np.nan, np.nan])
    np.testing.assert_equal(applied("tanh16", odd), [0.0, 1.0, -1.0, np.nan])
    np.testing.assert_equal(applied("erf16", odd), [0.0, 1.0, -1.0, np.nan])
    np.testing.assert_equal(applied("round16", np.array([0.5, 1.5, -2.5])), [0.0, 2.0, -2.0])
