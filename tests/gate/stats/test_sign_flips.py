"""The test of flipped signs: exact where it can be, and as often wrong as it says."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nw_gate.stats.interval import leans_above


def by_hand(differences):
    sizes = [abs(d) for d in differences if d]
    sums = [sum(s * x for s, x in zip(signs, sizes, strict=True))
            for signs in itertools.product((-1, 1), repeat=len(sizes))]  # fmt: skip
    return sum(total >= sum(differences) - 1e-9 for total in sums) / len(sums)


@given(st.lists(st.sampled_from([-1.0, -0.5, -0.25, 0.0, 0.25, 0.5, 1.0]), max_size=10))
def test_it_is_the_share_of_all_combinations_of_signs(differences):
    assert leans_above(np.array(differences)) == pytest.approx(by_hand(differences))


def test_six_losses_without_a_win_have_one_chance_in_64():
    assert leans_above(np.array([0.5] * 6 + [0.0] * 90)) == pytest.approx(1 / 64)


def test_drawn_signs_come_near_to_all_of_them():
    differences = np.array([0.5] * 11 + [-0.5] * 4)
    assert leans_above(differences) == pytest.approx(by_hand(differences), abs=0.006)


def test_order_and_zeros_say_nothing():
    rng = np.random.default_rng(3)
    differences = rng.choice([-0.5, 0.0, 0.5], 60)
    shuffled = rng.permutation(np.concatenate([differences, np.zeros(17)]))
    assert leans_above(differences) == leans_above(shuffled)
    assert leans_above(np.zeros(5)) == 1.0


def test_without_an_effect_it_finds_one_as_seldom_as_it_says():
    rng = np.random.default_rng(7)
    found = [leans_above(rng.choice([-1.0, 0.0, 1.0], 40, p=[0.2, 0.6, 0.2])) for _ in range(400)]
    assert np.mean(np.array(found) <= 0.05) < 0.08
