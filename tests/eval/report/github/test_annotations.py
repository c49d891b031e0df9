"""Annotations stand at the suite's own lines, are few, and say one thing each."""

from pathlib import Path

import pytest

from nw_base.errors import Problem, SuiteError, UsageError
from nw_eval.reporting.github import (
    END_GROUP,
    begin_group,
    command,
    error_annotations,
    run_annotations,
)
from nw_eval.reporting.scene_states import suite_lines
from nw_eval.suite import Gate
from nw_gate.absolute import judge

BAR = Gate(success_rate=0.75)


def test_a_regressed_run_annotates_its_gate_and_its_worst_scenes_first(
    runner, make_row, make_run, suite_file, of_suite
):
    reached = {"hurdles/one": 4, "gaps/wide": 0, "gaps/near": 1}
    rows = [make_row(scene, k, to) for scene, to in reached.items() for k in range(20)]
    run = make_run(dict.fromkeys(reached, 20), **of_suite)
    verdict = judge(rows, BAR, run.planned)
    lines = suite_lines(run, suite_file.parents[1])
    shown = runner.commands("\n".join(run_annotations(run, verdict, lines)))
    assert [each.name for each in shown] == ["error", "error", "error"]
    assert [(each.properties["file"], each.properties["line"]) for each in shown] == [
        ("suites/hurdles.yaml", "11"),
        ("suites/hurdles.yaml", "9"),
        ("suites/hurdles.yaml", "9"),
    ]
    assert [each.properties["title"] for each in shown] == [
        "REGRESSED: hurdles",
        "below the bar: gaps/wide",
        "below the bar: gaps/near",
    ]
    # A per cent sign and a comma come back as they were.
    assert shown[1].message.startswith(
        "below the bar 0.75 by itself; success 0.000, completed 0 of 20"
    )


def test_there_are_eight_at_most(runner, make_row, make_run):
    scenes = [f"gaps/g{k:02d}" for k in range(30)]
    rows = [make_row(scene, k, 0) for scene in scenes for k in range(5)]
    run = make_run(dict.fromkeys(scenes, 5))
    shown = run_annotations(run, judge(rows, BAR, run.planned), None)
    assert len(shown) == 8
    assert all(each.properties.keys() == {"title"} for each in runner.commands("\n".join(shown)))


def test_a_run_that_passes_warns_of_weak_scenes_only(runner, make_row, make_run):
    scenes = [f"s{k}" for k in range(8)]
    rows = [make_row(scene, k, 4) for scene in scenes for k in range(20)]
    run = make_run(dict.fromkeys(scenes, 20))
    assert run_annotations(run, judge(rows, BAR, run.planned), None) == ()
    rows += [make_row("bad", k, 1) for k in range(5)]
    run = make_run({**dict.fromkeys(scenes, 20), "bad": 5})
    verdict = judge(rows, BAR, run.planned)
    assert verdict.verdict == "PASS"
    (shown,) = runner.commands("\n".join(run_annotations(run, verdict, None)))
    assert (shown.name, shown.properties["title"]) == ("warning", "below the bar: bad")


def test_every_fault_of_a_suite_is_at_its_own_line(runner, tmp_path):
    files = [tmp_path / "suites" / "a.yaml", Path("/elsewhere/policy.yaml")]
    faults = [
        Problem(file=str(file), line=3, column=5, message="no scene 'x'", fix="name one")
        for file in files
    ]
    shown = runner.commands("\n".join(error_annotations(SuiteError(faults), tmp_path)))
    assert shown[0].properties == {
        "file": "suites/a.yaml",
        "line": "3",
        "col": "5",
        "title": "nw-eval",
    }
    assert shown[1].properties == {"title": "nw-eval"}
    (plain,) = error_annotations(UsageError("no suite 'x'", fix="y"), tmp_path)
    assert plain == "::error title=nw-eval::no suite 'x'; y"


@pytest.mark.parametrize("text", ["50 % of a, b: c", "%0A::error::x", "a%25b", "::x::y"])
def test_what_a_command_says_comes_back_as_it_was_and_is_no_other_command(runner, text):
    (shown,) = runner.commands(command("warning", f"m {text}", title=f"t {text}", file=None))
    assert (shown.message, shown.properties) == (f"m {text}", {"title": f"t {text}"})


def test_a_group_is_one_line_whatever_it_is_called(runner, evil):
    (shown,) = runner.commands(begin_group(f"nw-eval run {evil}"))
    assert (shown.name, shown.properties) == ("group", {})
    assert shown.message.startswith("nw-eval run \\x1b[2Jred\\u202e")
    assert runner.commands(END_GROUP)[0].name == "endgroup"


def test_strangers_names_are_text_in_an_annotation(runner, make_row, make_run, evil):
    rows = [make_row(f"s{evil}", 0, None, error_text=evil)]
    run = make_run({rows[0].scene: 1}, suite={"name": evil})
    log = "\n".join(run_annotations(run, judge(rows, BAR, run.planned), None))
    shown = runner.commands(log)
    assert [each.name for each in shown] == ["error", "error"]
    assert len(log.splitlines()) == 2
    for mark in ("\x1b", "\u202e", "\u2066", "\x00", "##["):
        assert mark not in log
    assert "\\u202e" in shown[1].properties["title"]
    assert "<script>" in shown[1].properties["title"]
