"""Who is compared with whom."""

import pytest

from nw_eval.twin.calibrate.calibrate import pairs_of


@pytest.mark.parametrize("in_sequence", [True, False])
def test_few_are_all_compared(in_sequence):
    assert len(pairs_of(60, in_sequence=in_sequence)) == 60 * 59 // 2


def test_all_are_compared_where_names_say_nothing():
    assert len(pairs_of(200, in_sequence=False)) == 200 * 199 // 2


def test_many_frames_are_compared_with_neighbours_and_across_loops():
    pairs = pairs_of(1000, in_sequence=True)
    assert len(pairs) == len(set(pairs)) < 1000 * 18 + 60 * 59 // 2
    assert all(0 <= i < j < 1000 for i, j in pairs)
    assert {(500, 500 + step) for step in (*range(1, 11), 16, 32, 64, 128, 256)} <= set(pairs)
    assert (0, 986) in pairs  # The film's end with its beginning.
    assert len([1 for i, j in pairs if j - i > 600]) > 100


@pytest.mark.parametrize("count", [0, 1])
def test_one_has_none_to_be_compared_with(count):
    assert pairs_of(count, in_sequence=True) == []
