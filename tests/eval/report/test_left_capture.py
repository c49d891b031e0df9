"""Reports count apart what left the captured volume, and charge nobody with it."""

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from nw_eval.reporting.headline import headline
from nw_eval.reporting.html.page import render_html
from nw_eval.reporting.junit import junit_xml
from nw_eval.reporting.markdown import render_markdown
from nw_eval.reporting.scene_states import scene_states
from nw_eval.suite import Gate
from nw_gate.absolute import judge
from nw_gate.settings import Validity

FOLDER = Path("reports/r")
FAR = {
    "capture_distance": (0.2,) * 5 + (1.75,) * 10,
    "capture_angle": (0.1,) * 14 + (0.5,),
    "capture_alpha": (1.0,) * 14 + (0.25,),
    "coverage_min": 0.25,
}


@pytest.fixture
def judged(make_row, make_run):
    rows = [make_row("clear", k, 4) for k in range(30)]
    rows += [make_row("foggy", k, 0 if k < 4 else 4, **(FAR if k < 4 else {})) for k in range(10)]
    planned = {"clear": 30, "foggy": 10}
    gate = Gate(success_rate=0.5, validity=Validity(distance=0.5))
    return make_run(planned), rows, judge(rows, gate, planned)


def test_the_headline_counts_them(judged):
    run, _, verdict = judged
    assert verdict.verdict == "PASS"
    assert "completed 36 of 36 counted trials; 36 of 40 ran in 2 scenes · " in headline(
        verdict, run
    )


def test_tables_have_them_by_scene_and_one_by_one_and_not_among_the_worst(judged):
    run, rows, verdict = judged
    page = render_markdown(run, rows, verdict, FOLDER)
    (foggy,) = [line for line in page.splitlines() if line.startswith("| foggy ")]
    assert [cell.strip() for cell in foggy.split("|")][2:5] == ["6 of 10", "4", "1.000"]
    assert "foggy-000 |   1.75 m |     0.50 rad |           0.25 | fell" in page
    assert "Worst trials" not in page
    assert "Out of the captured volume" not in page
    assert "Left the captured volume" in render_html(run, rows, verdict, FOLDER)


def test_junit_skips_a_scene_that_nobody_could_see_and_says_why(judged):
    run, rows, verdict = judged
    assert [item.state for item in scene_states(verdict)] == ["fine", "unseen"]
    (suite,) = ET.fromstring(junit_xml(run, rows, verdict, FOLDER, None))
    clear, foggy, whole = suite.iter("testcase")
    skipped = foggy.find("skipped")
    assert skipped is not None
    assert skipped.attrib["type"] == "left_capture"
    reason = "4 of 10 trials left the captured volume and are counted apart; success 1.000"
    assert skipped.attrib["message"].startswith(reason)
    assert foggy.find("failure") is None
    assert clear.find("skipped") is None
    assert whole.find("failure") is None
    assert suite.attrib["skipped"] == "1"
    counts = [each.attrib for each in suite.iter("property") if "left" in each.attrib["name"]]
    assert counts == [{"name": "left_capture", "value": "4"}] * 2


def test_a_run_in_which_nothing_left_says_nothing_of_it(make_row, make_run):
    rows = [make_row("clear", k, 4) for k in range(30)]
    planned = {"clear": 30}
    gate = Gate(success_rate=0.5, validity=Validity(distance=0.5, at_most=0.0))
    bare = judge(rows, Gate(success_rate=0.5), planned)
    run, limited = make_run(planned), judge(rows, gate, planned)
    pages = [render_markdown(run, rows, each, FOLDER) for each in (bare, limited)]
    assert "left capture" not in pages[0] + pages[1]
    assert junit_xml(run, rows, bare, FOLDER, None).count(b"left") == 0
    (line,) = set(pages[1].splitlines()) - set(pages[0].splitlines())
    assert "gate.validity was not looked at in 1 scene" in line
