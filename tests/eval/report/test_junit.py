"""A run as JUnit: cases whose failures are the verdict's, and which any reader of XML can read."""

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from junitparser import JUnitXml

from nw_base.errors import Problem, SuiteError, UsageError
from nw_eval.reporting.junit import junit_of_error, junit_xml
from nw_eval.reporting.scene_states import suite_lines
from nw_eval.suite import Gate
from nw_gate.absolute import judge
from nw_gate.baseline.combine import without_baseline

BAR = Gate(success_rate=0.75)
FOLDER = Path("reports/r")


def read(data):
    (suite,) = ET.fromstring(data)
    return suite


def cases(suite):
    return {f"{case.get('classname')} {case.get('name')}": case for case in suite.iter("testcase")}


def properties(of):
    found = of.find("properties")
    assert found is not None
    return {each.attrib["name"]: each.attrib["value"] for each in found}


@pytest.fixture
def regressed(make_row):
    rows = [make_row("hurdles/one", k, 4) for k in range(20)]
    rows += [make_row("gaps/wide", k, k % 2, wall_s=1.5) for k in range(20)]
    planned = {"hurdles/one": 20, "gaps/wide": 20}
    return rows, planned, judge(rows, Gate(success_rate=0.9), planned)


def test_there_is_a_case_for_each_scene_and_one_for_the_verdict_with_their_places(
    make_run, regressed, suite_file, of_suite
):
    rows, planned, verdict = regressed
    run = make_run(planned, **of_suite)
    lines = suite_lines(run, suite_file.parents[1])
    suite = read(junit_xml(run, rows, verdict, FOLDER, lines))
    found = cases(suite)
    assert list(found) == [
        "nw.hurdles gaps/wide",
        "nw.hurdles hurdles/one",
        "nw.hurdles verdict",
    ]
    places = [(case.get("file"), case.get("line")) for case in found.values()]
    assert places == [("suites/hurdles.yaml", line) for line in ("9", "8", "11")]
    assert found["nw.hurdles gaps/wide"].get("time") == "30.0"
    assert (suite.get("tests"), suite.get("failures"), suite.get("errors")) == ("3", "2", "0")


def test_a_failure_has_one_sentence_and_the_commands_that_show_it(make_run, regressed):
    rows, planned, verdict = regressed
    suite = read(junit_xml(make_run(planned), rows, verdict, FOLDER, None))
    failure = cases(suite)["nw.hurdles gaps/wide"].find("failure")
    assert failure is not None
    assert failure.get("type") == "regressed"
    assert failure.get("message", "").startswith(
        "below the bar 0.9 by itself; success 0.125, completed 0 of 20"
    )
    assert failure.text is not None
    sentence, *commands = failure.text.splitlines()
    assert sentence == failure.get("message")
    assert commands == [
        f"nw-eval replay reports/r/mcap/gaps/wide/gaps-wide-{k:03d}.mcap" for k in (0, 2, 4)
    ]
    (whole,) = cases(suite)["nw.hurdles verdict"].iter("failure")
    assert whole.get("message", "").startswith(
        "REGRESSED by the bar · completed 20 of 40 trials in 2 scenes · "
    )
    assert properties(cases(suite)["nw.hurdles gaps/wide"])["mcap"].endswith("-000.mcap")
    assert properties(suite)["verdict"] == "REGRESSED"
    assert properties(suite)["exit_code"] == "1"
    assert float(properties(suite)["success"]) == pytest.approx(0.5625)
    of_scene = properties(cases(suite)["nw.hurdles gaps/wide"])
    assert float(of_scene["success"]) == pytest.approx(0.125)


def test_success_is_also_called_effect_until_the_next_release(make_run, regressed):
    rows, planned, verdict = regressed
    suite = read(junit_xml(make_run(planned), rows, verdict, FOLDER, None))
    for found in [properties(suite), properties(cases(suite)["nw.hurdles gaps/wide"])]:
        assert found["effect"] == found["success"]


@pytest.mark.parametrize(
    ("reached", "gate", "kind", "word"),
    [
        ([4] * 3, BAR, "failure", "INCONCLUSIVE"),
        ([4, None, 4], BAR, "error", "INFRASTRUCTURE"),
        ([4] * 60, BAR, None, "PASS"),
        ([0] * 3, Gate(), None, "RAN"),
    ],
)
def test_the_kind_of_a_result_is_the_verdicts(make_row, make_run, reached, gate, kind, word):
    rows = [make_row("a", k, to) for k, to in enumerate(reached)]
    verdict = judge(rows, gate, {"a": len(rows)})
    assert verdict.verdict == word
    suite = read(junit_xml(make_run({"a": len(rows)}), rows, verdict, FOLDER, None))
    case = cases(suite)["nw.hurdles verdict"]
    results = {each.tag: each.get("type") for each in case if each.tag in {"failure", "error"}}
    assert results == ({} if kind is None else {kind: word.lower()})
    text = case.findtext("system-out") if kind is None else case.findtext(kind)
    assert text is not None
    assert text.startswith(word)


def test_an_invalid_run_skips_its_scenes(make_row, make_run):
    rows = [make_row("a", k, 4) for k in range(3)]
    verdict = without_baseline(judge(rows, BAR, {"a": 3}), "the baseline is gone")
    suite = read(junit_xml(make_run({"a": 3}), rows, verdict, FOLDER, None))
    assert (suite.get("skipped"), suite.get("errors"), suite.get("failures")) == ("1", "1", "0")
    error = cases(suite)["nw.hurdles verdict"].find("error")
    assert error is not None
    assert error.get("type") == "invalid"
    assert "the baseline is gone" in (error.text or "")


def test_an_error_of_a_trial_is_told_in_its_scene(make_row, make_run):
    rows = [make_row("a", 0, 4), make_row("a", 1, None)]
    verdict = judge(rows, BAR, {"a": 2})
    suite = read(junit_xml(make_run({"a": 2}), rows, verdict, FOLDER, None))
    text = cases(suite)["nw.hurdles a"].findtext("error")
    assert text is not None
    assert text.splitlines()[1] == "a-001: signal 11"


def test_the_same_run_gives_the_same_bytes(make_run, regressed):
    rows, planned, verdict = regressed
    run = make_run(planned)
    ways = [junit_xml(run, order, verdict, FOLDER, None) for order in (rows, rows[::-1])]
    assert ways[0] == ways[1]


def test_names_that_xml_forbids_are_shown_as_text(make_row, make_run, evil):
    scene = f"s{evil}"
    rows = [make_row(scene, 0, None, error_text=evil), make_row(scene, 1, 4)]
    run = make_run({rows[0].scene: 2}, suite={"name": evil})
    data = junit_xml(run, rows, judge(rows, BAR, run.planned), FOLDER, None)
    text = data.decode()
    for mark in ("\x1b", "\u202e", "\u2066", "\x00", "\ufffe", "<script>", "<!--", "##[error]"):
        assert mark not in text
    assert "\\x1b[2Jred\\u202e" in text
    (case, _) = read(data).iter("testcase")
    assert "**bold** _low_" in (case.get("name") or "")
    assert [each.name for each in JUnitXml.fromstring(data.decode().partition("\n")[2])]


def test_an_error_before_a_verdict_is_an_error_at_its_place():
    fault = Problem(file="suites/a.yaml", line=3, column=1, message="no scene", fix="name one")
    suite = read(junit_of_error("suites/a.yaml", SuiteError([fault])))
    (case,) = suite.iter("testcase")
    assert (case.get("file"), case.get("line")) == ("suites/a.yaml", "3")
    (error,) = case.iter("error")
    assert error.get("type") == "SuiteError"
    assert error.get("message") == "suites/a.yaml:3:1: no scene; name one"
    assert properties(suite) == {"exit_code": "2"}
    plain = read(junit_of_error("x", UsageError("no suite 'x'")))
    assert next(plain.iter("error")).get("message") == "no suite 'x'"
