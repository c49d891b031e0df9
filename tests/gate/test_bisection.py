"""Which checkpoint of a series fell first."""

from __future__ import annotations

from math import ceil, log2

from hypothesis import given
from hypothesis import strategies as st

from nw_eval.gate.bisection import Decision, bisect


class Series:
    """Checkpoints whose verdicts are known, and what was asked of them."""

    def __init__(self, words: str) -> None:
        self.words: list[Decision] = [
            {"+": "PASS", "-": "REGRESSED", "?": "INCONCLUSIVE"}[letter]
            for letter in words  # pyright: ignore[reportAttributeAccessIssue]
        ]
        self.questions: list[int] = []

    def judge(self, place: int) -> Decision:
        self.questions.append(place)
        return self.words[place]


@given(good=st.integers(0, 40), bad=st.integers(1, 40))
def test_the_first_that_fell_is_found_by_halving(good: int, bad: int) -> None:
    series = Series("+" * good + "-" * bad)
    found = bisect(good + bad, series.judge)
    assert found.first_fallen == good
    assert found.last_good == (good - 1 if good else None)
    assert list(found.suspects) == [good]
    assert found.recovered == ()
    assert len(series.questions) == len(set(series.questions))
    # The last one, the halving, and one look on either side.
    assert len(series.questions) <= 1 + ceil(log2(good + bad)) + 1 + 2


def test_a_series_whose_last_one_is_as_good_as_ever_costs_one_verdict() -> None:
    series = Series("++++++++")
    found = bisect(8, series.judge)
    assert series.questions == [7]
    assert (found.first_fallen, found.last_good, list(found.suspects)) == (None, 7, [])


def test_a_checkpoint_that_is_left_open_is_passed_over_for_its_neighbours() -> None:
    found = bisect(8, Series("+++??---").judge)
    assert (found.last_good, found.first_fallen) == (2, 5)
    assert list(found.suspects) == [3, 4, 5], "any of them may have fallen first"


def test_a_series_that_recovers_is_said_not_to_be_monotone() -> None:
    found = bisect(9, Series("+++---++-").judge, everyone=True)
    assert found.first_fallen == 3
    assert found.recovered == (6, 7)
    found = bisect(9, Series("++---++--").judge)
    assert found.recovered == (6,), "in the middle of a stretch that halving left out"
    assert len(found.words) < 9


@given(words=st.text("+-?", min_size=1, max_size=30))
def test_whatever_the_series_nobody_is_asked_twice_and_what_is_said_was_seen(words: str) -> None:
    series = Series(words)
    found = bisect(len(words), series.judge)
    assert sorted(series.questions) == list(found.words)
    if found.first_fallen is not None:
        assert series.words[found.first_fallen] == "REGRESSED"
        assert found.first_fallen in found.suspects
    if found.last_good is not None:
        assert series.words[found.last_good] == "PASS"
    everyone = bisect(len(words), Series(words).judge, everyone=True)
    assert len(everyone.words) == len(words)
