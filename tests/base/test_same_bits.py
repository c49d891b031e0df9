"""Functions with the same bits everywhere: as exact as libm's, in arrays as one by one."""

from __future__ import annotations

import math

import numpy as np
import pytest

from nw_base import same_bits

RNG = np.random.default_rng(0)
SIGNED = np.concatenate([RNG.normal(size=2000), RNG.uniform(-700.0, 700.0, 2000), [0.0, -0.0, 1.0]])
ABOVE = np.concatenate([np.exp(RNG.uniform(-700.0, 700.0, 2000)), RNG.uniform(0.5, 2.0, 2000)])
SHARES = RNG.uniform(0.0, 1.0, 2000)


def units(found, wanted):
    """Return the largest error, in units in the last place."""
    return np.max(np.abs(found - wanted) / np.spacing(np.abs(wanted)))


@pytest.mark.parametrize(
    ("ours", "exact", "values"),
    [
        (same_bits.exp, math.exp, SIGNED),
        (same_bits.log, math.log, ABOVE),
        (same_bits.log2, math.log2, ABOVE),
        (same_bits.tan, math.tan, RNG.uniform(-10.0, 10.0, 2000)),
        (same_bits.arcsin, math.asin, np.concatenate([SHARES, -SHARES, [1.0, -1.0]])),
        (lambda x: same_bits.arctan2(x, 0.7), lambda x: math.atan2(x, 0.7), SIGNED),
        (lambda x: same_bits.arctan2(0.7, x), lambda x: math.atan2(0.7, x), SIGNED),
    ],
)
def test_they_are_as_exact_as_the_c_librarys(ours, exact, values):
    assert units(ours(values), np.array([exact(value) for value in values.tolist()])) <= 6.0


def test_powers_lose_what_their_logarithms_are_rounded_by():
    for exponent in (2.4, 1 / 2.4, 1.5):
        wanted = [share**exponent for share in SHARES.tolist()]
        np.testing.assert_allclose(same_bits.power(SHARES, exponent), wanted, rtol=5e-15)


def test_single_precision_is_the_nearest():
    values = SIGNED[:2000].astype(np.float32)
    wanted = np.array([math.exp(value) for value in values.tolist()]).astype(np.float32)
    assert same_bits.exp(values).dtype == np.float32
    assert np.array_equal(same_bits.exp(values), wanted)
    above = wanted + np.float32(0.1)
    logs = np.array([math.log(value) for value in above.tolist()]).astype(np.float32)
    assert np.array_equal(same_bits.log(above), logs)
    shares = SHARES.astype(np.float32)
    powers = np.array([value**2.4 for value in shares.tolist()]).astype(np.float32)
    assert np.array_equal(same_bits.power(shares, 2.4), powers)


@pytest.mark.filterwarnings("error")
def test_ends_of_the_numbers_are_answered_as_numpy_answers_them():
    ends = np.array([np.inf, -np.inf, np.nan, 800.0, -800.0, 0.0, -0.0, 5e-324, 1.0])
    with np.errstate(all="ignore"):
        wanted = {name: getattr(np, name)(ends) for name in ("exp", "log", "log2")}
    for name, values in wanted.items():
        found = getattr(same_bits, name)(ends)
        np.testing.assert_allclose(found, values, rtol=1e-15)
    assert same_bits.log2(np.array([8.0, 0.125, 1.0])).tolist() == [3.0, -3.0, 0.0]
    assert same_bits.power(np.array([0.0, 1.0]), 1 / 2.4).tolist() == [0.0, 1.0]
    assert np.isnan(same_bits.power(np.array([-1.0]), 1.5)).all()


def test_angles_have_the_signs_and_quadrants_of_the_c_librarys():
    ends = (0.0, -0.0, 1.0, -1.0, np.inf, -np.inf)
    for y in ends:
        for x in ends:
            (found,) = same_bits.arctan2(np.array([y]), np.array([x]))
            wanted = math.atan2(y, x)
            assert float(found) == wanted
            assert math.copysign(1.0, found) == math.copysign(1.0, wanted)
            assert float(same_bits.arctan2(y, x)) == wanted
    assert np.isnan(same_bits.arctan2(np.nan, 1.0))


def test_one_number_has_the_bits_that_it_has_in_an_array():
    y, x = RNG.normal(size=(2, 3000))
    pairs = zip(y.tolist(), x.tolist(), strict=True)
    assert [float(same_bits.arctan2(*pair)) for pair in pairs] == same_bits.arctan2(y, x).tolist()
    ones = [float(same_bits.arcsin(share)) for share in SHARES.tolist()]
    assert ones == same_bits.arcsin(SHARES).tolist()


def test_an_affine_transform_is_inverted():
    for _ in range(50):
        T = np.eye(4)
        T[:3] = RNG.normal(size=(3, 4)) * 10.0 ** RNG.uniform(-2, 2)
        inverse = same_bits.inverse(T)
        np.testing.assert_allclose(inverse, np.linalg.inv(T), rtol=1e-9, atol=1e-12)
        assert inverse[3].tolist() == [0.0, 0.0, 0.0, 1.0]
    with pytest.raises(np.linalg.LinAlgError):
        same_bits.inverse(np.diag([1.0, 0.0, 1.0, 1.0]))


def test_products_are_those_of_the_numbers():
    v, R = RNG.normal(size=3), RNG.normal(size=(3, 3))
    np.testing.assert_allclose(same_bits.product(v, R), v @ R, rtol=1e-14, atol=1e-15)
    assert same_bits.dot(v, R[0]) == pytest.approx(v @ R[0], abs=1e-14)
    assert same_bits.length([3.0, 4.0]) == 5.0
