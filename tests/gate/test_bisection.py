"""Which checkpoint of a series is flagged first."""

from __future__ import annotations

from dataclasses import replace
from math import ceil, log2
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hypothesis import given
from hypothesis import strategies as st

from nw_eval.api.reports import RunReport
from nw_eval.api.series import BisectedSeries
from nw_eval.cli.verbs.bisect import series_page
from nw_gate.absolute import judge
from nw_gate.bisection import Decision, bisect
from nw_gate.results.provenance import PolicyInfo, RunInfo, code_info, machine_info
from nw_gate.settings import Gate
from nw_gate.stats.interval import Interval
from nw_gate.verdict import Comparison

if TYPE_CHECKING:
    from collections.abc import Callable


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
def test_the_first_that_fell_is_found_by_halving(good, bad):
    series = Series("+" * good + "-" * bad)
    found = bisect(good + bad, series.judge)
    assert found.first_fallen == good
    assert found.last_good == (good - 1 if good else None)
    assert list(found.suspects) == [good]
    assert found.recovered == ()
    assert len(series.questions) == len(set(series.questions))
    # The last one, the halving, and one look on either side.
    assert len(series.questions) <= 1 + ceil(log2(good + bad)) + 1 + 2


def test_a_series_whose_last_one_is_as_good_as_ever_costs_one_verdict():
    series = Series("++++++++")
    found = bisect(8, series.judge)
    assert series.questions == [7]
    assert (found.first_fallen, found.last_good, list(found.suspects)) == (None, 7, [])


def test_a_checkpoint_that_is_left_open_is_passed_over_for_its_neighbours():
    found = bisect(8, Series("+++??---").judge)
    assert (found.last_good, found.first_fallen) == (2, 5)
    assert list(found.suspects) == [3, 4, 5], "any of them may have fallen first"


def test_a_series_that_recovers_is_said_not_to_be_monotone():
    found = bisect(9, Series("+++---++-").judge, everyone=True)
    assert found.first_fallen == 3
    assert found.recovered == (6, 7)
    found = bisect(9, Series("++---++--").judge)
    assert found.recovered == (6,), "in the middle of a stretch that halving left out"
    assert len(found.words) < 9


@given(words=st.text("+-?", min_size=1, max_size=30))
def test_whatever_the_series_nobody_is_asked_twice_and_what_is_said_was_seen(words):
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


DROPS = {
    "+": ("PASS", Interval(-0.01, 0.094)),
    "-": ("REGRESSED", Interval(0.031, 0.12)),
    "?": ("INCONCLUSIVE", Interval(-0.02, 0.15)),
}


def page_of(words: str, run_scene: Callable[..., Any], **changes: Any) -> str:
    """Return what `bisect` prints of a series with these verdicts, each with its drops."""
    found = bisect(len(words), Series(words).judge)
    rows = run_scene("a", [4, 4])
    runs: dict[int, RunReport] = {}
    for place in found.words:
        word, interval = DROPS[words[place]]
        against = Comparison(
            word=word, baseline_name="good", policy="p", basis="panel", claim="fresh", trials=2,
            budget=4, starts=60, baseline=0.95, drop=0.05, interval=interval,
            mean_regressed=word[0] == "R", false_alarm=0.01, max_drop=0.1, tolerate=0.02,
            scene_drop=0.1, alpha_pass=0.05, alpha_regr=0.01, scenes=(), reasons=(),
        )  # fmt: skip
        runs[place] = RunReport(
            folder=Path(),
            info=RunInfo(
                id="r",
                started="2026-11-26T09:00:00+00:00",
                suite_file="one.yaml",
                suite={"name": "one"},
                suite_digest="aa" * 32,
                policy=PolicyInfo(name="p", checkpoint_digest="cc" * 32),
                scenes={},
                code=code_info(),
                machine=machine_info(),
            ),
            verdict=replace(judge(rows, Gate(), {"a": 2}), against=replace(against, **changes)),
            rows=tuple(rows),
            page=None,
        )
    names = tuple(f"step-{place}" for place in range(len(words)))
    return series_page(
        BisectedSeries(
            baseline="good", checkpoints=names, runs=runs, found=found, folder=Path("out")
        )
    )


def test_the_first_flagged_and_the_last_that_passed_are_told_with_their_intervals(run_scene):
    page = page_of("++--", run_scene)
    flagged = (
        "the first flagged: step-2, worse than the good one by 0.03 (99 % confidence) to "
        "0.12 (95 %)"
    )
    passed = (
        "the last before it that passed: step-1; at most 0.09 worse than the good one (95 % "
        "confidence)"
    )
    assert [line for line in page.splitlines() if "step-" in line][4:] == [flagged, passed]
    assert "drop (99 % lower, 95 % upper)" in page.splitlines()[0]
    assert "first that fell" not in page
    assert "up to" not in page_of("++--", run_scene, basis="same"), "it is the good one itself"


def test_what_is_left_open_before_the_first_flagged_is_named(run_scene):
    page = page_of("+??-", run_scene)
    assert "not passed and not flagged before it: step-1, step-2" in page
    assert "it is the first of the series" in page_of("----", run_scene)
    passed = page_of("++++", run_scene)
    assert "none was flagged: step-3 passed; at most 0.09 worse" in passed
    assert "no checkpoint was flagged; undecided: step-3" in page_of("+++?", run_scene)
