"""Step summary and comment: the worst first, within their budgets, and strangers' as text."""

from dataclasses import replace
from pathlib import Path

import pytest

from nw_base.errors import StoreError
from nw_eval.reporting.github import SUMMARY, comment_page, summary_page
from nw_eval.suite import Gate
from nw_gate.absolute import judge

FOLDER = Path("reports/r")


def cells(page, title):
    """First cells of the table under a title."""
    body = page.split(f"## {title}\n", 1)[1].split("\n## ", 1)[0]
    return [line.split("|")[1].strip() for line in body.splitlines() if line.startswith("|")][2:]


def judged(make_row, make_run, scenes, **changes):
    """A run of many scenes, of which every seventh goes badly; two are judged for all."""
    names = [f"places/{k:05d}" for k in range(scenes)]
    rows = [make_row(name, 0, 0 if k % 7 == 0 else 4, **changes) for k, name in enumerate(names)]
    run = make_run(dict.fromkeys(names, 1))
    short = judge(rows[:2], Gate(success_rate=0.6), dict.fromkeys(names[:2], 1))
    bad, good = short.per_scene
    scores = [
        replace(bad if k % 7 == 0 else good, scene=name, planned=1) for k, name in enumerate(names)
    ]
    verdict = replace(short, per_scene=tuple(scores), n=scenes, planned=scenes)
    return run, rows, verdict, FOLDER


def test_a_small_run_is_shown_whole_under_its_suite_and_policy(make_row, make_run):
    page = summary_page(*judged(make_row, make_run, 14))
    assert page.startswith(
        "# INCONCLUSIVE: hurdles, go1-parkour\n\nINCONCLUSIVE · completed 12 of 14 "
    )
    assert len(cells(page, "Success by scene")) == 14
    assert "more in" not in page
    assert "## How sure" in page


def test_a_large_run_keeps_its_worst_scenes_and_says_how_many_more_there_are(make_row, make_run):
    page = summary_page(*judged(make_row, make_run, 6000))
    assert len(page.encode()) <= SUMMARY == 256 * 1024
    shown = cells(page, "Success by scene")
    assert len(shown) == 1000
    worst = [f"places/{k:05d}" for k in range(0, 6000, 7)]
    assert shown[: len(worst)] == worst
    assert "5000 more in the run's artifact. Success is the share" in page
    assert "## Provenance" in page


def test_a_summary_takes_what_room_is_left_and_refuses_where_there_is_none(make_row, make_run):
    run = judged(make_row, make_run, 300)
    page = summary_page(*run, budget=9_000)
    assert 5_000 < len(page.encode()) <= 9_000
    assert len(cells(page, "Success by scene")) == 30
    with pytest.raises(StoreError, match="more than the 1000 bytes"):
        summary_page(*run, budget=1000)


def test_long_words_of_strangers_cost_rows_and_no_more(make_row, make_run):
    run, rows, verdict, folder = judged(make_row, make_run, 400)
    wordy = replace(verdict, reasons=("&" * 9000,) * 20)
    long = [replace(score, scene=f"{'&' * 400}{score.scene}") for score in verdict.per_scene]
    page = summary_page(run, rows, replace(wordy, per_scene=tuple(long)), folder)
    assert len(page.encode()) <= SUMMARY
    assert len(cells(page, "Success by scene")) == 100
    assert "* 8 more in the run's artifact" in page


def test_a_comment_is_marked_short_and_mostly_folded(make_row, make_run):
    page = comment_page(*judged(make_row, make_run, 3200))
    mark, first, *_ = page.splitlines()
    assert mark == "<!-- nw-eval: hurdles -->"
    assert first.startswith("# INCONCLUSIVE: hurdles, go1-parkour")
    assert len(page) < 60_000
    assert len(cells(page, "Success by scene")) == 20
    open_part = page.split("<details>")[0]
    assert "## Success by scene" in open_part
    assert "## Outcomes" not in open_part
    assert page.rstrip().endswith("</details>")


def test_the_same_run_gives_the_same_page(make_row, make_run):
    run, rows, verdict, folder = judged(make_row, make_run, 50)
    assert summary_page(run, rows, verdict, folder) == summary_page(
        run, rows[::-1], verdict, folder
    )
