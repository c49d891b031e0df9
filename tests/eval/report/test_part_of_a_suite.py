"""A run of some of its suite's scenes says so wherever it is shown, and where it was trained."""

from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from nw_eval.reporting.console import print_summary
from nw_eval.reporting.github import comment_page, run_annotations, summary_page
from nw_eval.reporting.html.page import render_html
from nw_eval.reporting.html.runs import ListedRun, render_index
from nw_eval.reporting.junit import junit_xml
from nw_eval.reporting.markdown import render_markdown
from nw_eval.suite import Gate
from nw_gate.baseline.combine import judge_run
from nw_gate.results.provenance import SceneInfo

PART = "1 of the suite's 2 scenes"
FOLDER = Path("reports/r")


def surfaces(run, rows, verdict):
    """What each place where a run is shown says of it."""
    console = Console(file=StringIO(), width=300)
    print_summary(console, run, rows, verdict, FOLDER)
    facts = (run, rows, verdict, FOLDER)
    listed = ListedRun(folder="reports/r", href=None, info=run, verdict=verdict)
    return {
        "terminal": console.file.getvalue(),
        "report.md": render_markdown(*facts),
        "report.html": render_html(*facts).replace("&#39;", "'"),
        "JUnit": junit_xml(*facts, None).decode().replace("&apos;", "'"),
        "summary": summary_page(*facts),
        "comment": comment_page(*facts),
        "annotations": "\n".join(run_annotations(run, verdict, None)),
        "index": render_index([listed], []).replace("&#39;", "'"),
    }


@pytest.mark.parametrize("reached", [4, 1])
def test_every_surface_says_that_scenes_of_the_suite_were_left_out(make_row, make_run, reached):
    rows = [make_row("a", k, reached) for k in range(40)]
    run = make_run({"a": 40}, left_out=("b",))
    verdict = judge_run(rows, run, Gate(success_rate=0.75), None)
    for name, text in surfaces(run, rows, verdict).items():
        if name != "annotations" or reached < 4:  # A PASS has nothing to annotate.
            assert PART in text, name
    whole = run.model_copy(update={"left_out": ()})
    for name, text in surfaces(whole, rows, verdict).items():
        assert "of the suite's" not in text, name


def splits(**of):
    return {
        name: SceneInfo(digest="dd" * 32, task="hurdles", trials=20, split=split)
        for name, split in of.items()
    }


def test_scenes_are_marked_where_the_policy_was_trained_and_the_means_of_both_stand_under_them(
    make_row, make_run
):
    reached = {"a": 4, "b": 3, "c": 2, "d": 1}
    rows = [make_row(scene, k, to) for scene, to in reached.items() for k in range(20)]
    run = make_run({}, scenes=splits(a="train", b="train", c="eval", d=None))
    verdict = judge_run(rows, run, Gate(success_rate=0.75), None)
    marked = {item.scene: item.split for item in verdict.per_scene}
    assert marked == {"a": "train", "b": "train", "c": "eval", "d": None}
    told = (
        "Mean success: 0.875 in 2 scenes that it was trained in (train), 0.500 in 1 scene that it "
        "was not trained in (eval)."
    )
    shown = surfaces(run, rows, verdict)
    for name in ("terminal", "report.md", "report.html"):
        assert told in shown[name].replace("\\(", "(").replace("\\)", ")"), name
    cells = [line.split("|")[1:3] for line in shown["report.md"].splitlines() if "| b " in line]
    assert [cell.strip() for cell in cells[0]] == ["b", "train"]
    cells = [line.split("|")[1:3] for line in shown["report.md"].splitlines() if "| d " in line]
    assert [cell.strip().strip("\\") for cell in cells[0]] == ["d", "-"]


def test_a_policy_of_which_nothing_is_known_has_no_split(make_row, make_run):
    rows = [make_row("a", k, 4) for k in range(20)]
    run = make_run({"a": 20})
    verdict = judge_run(rows, run, Gate(success_rate=0.75), None)
    for name, text in surfaces(run, rows, verdict).items():
        assert "it was trained in" not in text, name
        assert "| split |" not in text, name
