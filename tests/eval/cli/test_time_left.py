"""The time that is left is what the last trials took, and is renewed while a run goes on."""

from types import SimpleNamespace

import pytest

from nw_eval.cli.terminal import progress as shown
from nw_eval.cli.terminal.time_left import TimeLeft, duration


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


def end(left, clock, *, after, times=1):
    for _ in range(times):
        clock.now += after
        left.ended()


def test_nothing_is_said_before_the_first_end_and_after_the_last(clock):
    left = TimeLeft(clock)
    assert left.in_words(10) == ""
    end(left, clock, after=4.0)
    assert left.seconds(10) == pytest.approx(40.0)
    assert left.in_words(10) == "about 40 s left"
    assert left.in_words(0) == ""


def test_it_falls_with_the_clock_and_grows_when_a_trial_is_overdue(clock):
    left = TimeLeft(clock)
    end(left, clock, after=10.0, times=4)
    told = []
    for _ in range(12):
        clock.now += 5.0
        told.append(left.seconds(3))
    assert told[:2] == pytest.approx([25.0, 20.0])
    low = told.index(min(told))
    assert told[low:] == sorted(told[low:])
    assert told[-1] > 20.0


def test_results_that_came_at_once_do_not_count_for_long(clock):
    left = TimeLeft(clock)
    end(left, clock, after=0.001, times=300)
    end(left, clock, after=5.0, times=13)
    assert left.seconds(20) == pytest.approx(100.0, rel=0.1)


def test_slow_trials_have_an_estimate_too(clock):
    left = TimeLeft(clock)
    end(left, clock, after=200.0, times=3)
    assert left.in_words(2) == "about 7 min left"


def test_durations_have_two_digits():
    assert [duration(x) for x in (0.2, 59.6, 99.6, 3600.0, 7200.0)] == [
        "1 s", "60 s", "2 min", "60 min", "2.0 h",
    ]  # fmt: skip


def test_a_log_says_how_long_the_rest_takes_and_says_it_anew(capsys, monkeypatch, clock):
    monkeypatch.setattr(shown, "TimeLeft", lambda: TimeLeft(clock))
    monkeypatch.setattr(shown, "_LOG_EVERY", 0.0)
    row = SimpleNamespace(success=1.0)
    with shown.RunProgress(bars=False) as progress:
        progress.planned(total=4, finished=0)
        for seconds in (10.0, 30.0, 20.0, 20.0):
            clock.now += seconds
            progress.trial(row)
    lines = capsys.readouterr().err.splitlines()
    assert [line.rpartition(", ")[2] for line in lines] == [
        "about 30 s left", "about 40 s left", "about 20 s left", "success so far 1.00",
    ]  # fmt: skip


def test_a_bar_shows_it_also_between_two_trials(clock):
    left = TimeLeft(clock)
    column = shown._TimeLeftColumn(left)
    task = SimpleNamespace(description="trials", total=5, completed=1)
    assert column.render(task).plain == ""
    end(left, clock, after=10.0)
    assert column.render(task).plain == "about 40 s left"
    clock.now += 4.0
    assert column.render(task).plain == "about 36 s left"
    building = SimpleNamespace(description="building flat/carpet_room", total=1.0, completed=0.5)
    assert column.render(building).plain == ""
    assert column.max_refresh < 1.0
