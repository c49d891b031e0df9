"""Results that come from earlier runs are counted apart, and so is what was compared of them."""

from dataclasses import replace
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from nw_eval.reporting.console import print_summary
from nw_eval.reporting.markdown import render_markdown
from nw_eval.reporting.tables.run import taken_over, throughput_table
from nw_eval.suite import Gate
from nw_gate.absolute import judge
from nw_gate.baseline.combine import judge_run
from nw_gate.results.provenance import CacheInfo

BAR = Gate(success_rate=0.5)


@pytest.fixture
def rows(make_row):
    """Return twenty rows, of which five ran, each for 6 s."""
    made = [replace(make_row("a", k, 4), wall_s=6.0, steps=100, policy_s=1.0) for k in range(20)]
    return [replace(row, cached=row.seed_index >= 5) for row in made]


@pytest.fixture
def run(make_run):
    info = make_run({"a": 20})
    return info.model_copy(update={"wall_s": 30.0, "workers": 1, "cache": CacheInfo(reexecuted=1)})


SENTENCE = "Cache: 15 of 20 results reused. 1 trial was re-run as a check and matched."


def test_every_surface_says_how_many_results_were_taken_over(rows, run):
    assert taken_over(run, rows) == SENTENCE
    console = Console(file=StringIO(), width=200)
    facts = (run, rows, judge(rows, BAR, run.planned), Path("reports/r"))
    print_summary(console, *facts)
    assert SENTENCE in console.file.getvalue().splitlines()
    assert SENTENCE in render_markdown(*facts)


def test_stages_are_of_what_ran(rows, run):
    table = throughput_table(rows, run)
    assert table.note.startswith("40.0 trials per minute on 1 worker")
    assert dict(row[:2] for row in table.rows)["policy"] == "5.0"


def test_where_all_was_taken_over_no_time_went_anywhere(rows, run):
    table = throughput_table([replace(row, cached=True) for row in rows], run)
    assert table.rows == ()


def test_a_run_without_such_results_says_nothing_of_them(rows, run):
    ran = [replace(row, cached=False) for row in rows]
    alone = run.model_copy(update={"cache": None})
    assert taken_over(alone, ran) == ""


def test_a_result_that_differed_makes_every_verdict_one_of_infrastructure(rows, run):
    assert judge_run(rows, run, BAR, None).verdict == "PASS"
    differing = CacheInfo(reexecuted=2, differing=("trial x came out otherwise",))
    doubted = run.model_copy(update={"cache": differing})
    verdict = judge_run(rows, doubted, BAR, None)
    assert (verdict.verdict, verdict.exit_code) == ("INFRASTRUCTURE", 4)
    assert verdict.reasons[0] == "trial x came out otherwise"
    said = " 2 trials were re-run as a check and 1 differed."
    assert taken_over(doubted, rows).endswith(said)


def test_what_a_session_says_adds_to_what_those_before_it_said():
    first = CacheInfo(reexecuted=2, differing=("a",))
    later = CacheInfo(reexecuted=1).after(first)
    assert (later.off, later.reexecuted, later.differing) == ("", 3, ("a",))
    assert CacheInfo(off="--no-cache").after(first).off == ""
    assert CacheInfo(off="--no-cache").after(None).off == "--no-cache"
    assert CacheInfo(reexecuted=1).after(CacheInfo(off="--no-cache")).off == ""
