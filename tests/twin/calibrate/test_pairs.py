"""Who is compared with whom."""

import numpy as np
import pytest

from nw_twin.calibrate.features import most_alike, pairs_of


@pytest.mark.parametrize("in_sequence", [True, False])
def test_few_are_all_compared(in_sequence):
    assert len(pairs_of(30, in_sequence=in_sequence)) == 30 * 29 // 2


def test_where_names_say_nothing_only_pictures_tell_what_is_compared():
    assert pairs_of(31, in_sequence=False) == []


def test_many_frames_are_compared_with_neighbours_and_some_farther_off():
    pairs = pairs_of(1000, in_sequence=True)
    assert len(pairs) == len(set(pairs)) < 1000 * 12
    assert all(0 <= i < j < 1000 for i, j in pairs)
    assert {(500, 500 + step) for step in (1, 2, 3, 4, 5, 8, 16, 32, 64, 128, 256)} <= set(pairs)


def test_each_is_compared_with_the_twelve_most_similar_and_with_none_that_is_not():
    scores = np.zeros((40, 40), np.int64)
    scores[0, 10:30] = scores[10:30, 0] = np.arange(20, 0, -1)  # Falls: of 10 to 21 the largest.
    scores[39, 38] = scores[38, 39] = 3
    pairs = most_alike(scores)
    mine = {j for i, j in pairs if i == 0}
    assert set(range(10, 22)) <= mine  # Zero's own choice;
    assert mine == set(range(10, 27))  # others choose zero, while they share four matches with it.
    assert (38, 39) not in pairs


@pytest.mark.parametrize("count", [0, 1])
def test_one_has_none_to_be_compared_with(count):
    assert pairs_of(count, in_sequence=True) == []
