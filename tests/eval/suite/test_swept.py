"""Axes of a sweep, as they are written."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nw_base.errors import UsageError
from nw_sim.axes import SweptAxis


@pytest.mark.parametrize(
    ("words", "values"),
    [
        ("friction=0.3..1.2", (0.3, 0.45, 0.6, 0.75, 0.9, 1.05, 1.2)),
        ("payload=0..6:4", (0.0, 2.0, 4.0, 6.0)),
        ("push=1,0,.5", (0.0, 0.5, 1.0)),
        ("camera_pitch=-0.2..0.2:3", (-0.2, 0.0, 0.2)),
        ("latency=0..0.1:4", (0.0, 0.04, 0.06, 0.1)),
    ],
)
def test_ranges_and_lists_are_values(words, values):
    assert SweptAxis.of(words).values == values


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("frction=0..1", "there is no axis 'frction'"),
        ("friction", "'' is not a range of values"),
        ("friction=a..b", "'a..b' is not a range of values"),
        ("friction=0.3..1.2:1", "has 1 step;"),
        ("friction=0.3..1.2:999", "has 999 steps"),
        ("friction=0.5", "has one value"),
        ("friction=0..1", "0.0: must be more than 0"),
        ("payload=0..90:2", "90.0: must be at most 20"),
        ("friction=1e999,1", "inf: input should be"),
        ("latency=1e999,1", "inf: input should be"),
    ],
)
def test_an_invalid_axis_is_refused_with_an_example(words, message):
    with pytest.raises(UsageError) as caught:
        SweptAxis.of(words)
    assert message in str(caught.value)
    assert caught.value.fix


@given(st.text(max_size=40))
def test_any_words_are_an_axis_or_a_sentence(words):
    try:
        axis = SweptAxis.of(words)
    except UsageError:
        return
    assert list(axis.values) == sorted(set(axis.values))
