"""What becomes of a suite's tests, by its verdict."""

import os
import signal
import xml.etree.ElementTree as ET
from dataclasses import replace
from functools import partial

import pytest

from nw_eval import api
from nw_eval.api import baselines_saved
from nw_eval.engine import session
from nw_eval.reporting.junit import junit_xml
from nw_sim.rollout import trial

FLAT, HURDLE, LOGS = "flat/carpet_room", "hurdles/one_low_carpet", "hurdles/two_logs_park"


def test_a_policy_that_passes_passes_every_test_and_a_last_line_says_by_how_much(suite, run):
    gate = "gate: {success_rate: 0.05, confidence: 0.5}"
    suite(scenes=[HURDLE], trials=2, duration=4.0, gate=gate)
    done = run("tiny.yaml", "-v", "--nw-policy", "go1-parkour")
    done.assert_outcomes(passed=2)
    done.stdout.fnmatch_lines(
        [
            f"tiny.yaml::{HURDLE} PASSED*",
            "tiny.yaml::verdict PASSED*",
            "*- nw-eval -*",
            "tiny.yaml: PASS * report: reports/tiny-*/report.md",
        ]
    )


def test_a_suite_without_a_gate_passes_once_its_trials_have_run_and_shows_nothing_of_a_scene(
    suite, run
):
    suite(gate="")
    done = run("tiny.yaml", "-rs")
    done.assert_outcomes(passed=1, skipped=1)
    done.stdout.fnmatch_lines(
        [
            "tiny.yaml: RAN *",
            (
                "SKIPPED [[]1] tiny.yaml:8: not judged: success 0.000, completed 0 of 1 trial; "
                "the verdict is RAN, which means only that the trials ran"
            ),
        ]
    )


def test_a_policy_that_fails_is_reported_as_verdict_table_and_replay_command(suite, run):
    suite("suites/tiny.yaml", scenes=[FLAT, HURDLE], trials=4)
    done = run("suites/tiny.yaml", "--nw-report-dir", "out")
    done.assert_outcomes(failed=3)
    done.stdout.fnmatch_lines(
        [
            "*_ suites/tiny.yaml: flat/carpet_room _*",
            "flat/carpet_room: below the bar 0.9 by itself; success 0.000, completed 0 of 4 trials",
            "Success by scene",
            f" {FLAT} *",
            "nw-eval replay out/tiny-*/mcap/flat/carpet_room/flat-carpet_room-00*.mcap",
            "report: out/tiny-*/report.md and report.html",
            "*_ suites/tiny.yaml: verdict _*",
            "REGRESSED * completed 0 of 8 trials in 2 scenes * success 0.000 *",
            "* success is at most *, the bar is 0.9",
            f" {HURDLE} *",
            f"FAILED suites/tiny.yaml::{FLAT} - {FLAT}: below the bar*",
            "FAILED suites/tiny.yaml::verdict - REGRESSED*",
        ]
    )
    whole = done.stdout.str()
    assert "Traceback" not in whole
    assert ".py:" not in whole
    first = whole[: whole.index("_ suites/tiny.yaml: hurdles")]
    assert f"\n {HURDLE} " not in first, "a scene's table is about that scene"
    # pytest does not shorten the lines of its own summary where the variable CI is set.
    report, _ = whole.split("short test summary info")
    assert report.count("completed 0 of 8 trials in 2 scenes") == 1, "the headline appears once"


def test_junit_has_a_sentence_for_a_message_and_the_figures_as_properties(suite, run, pytester):
    suite(scenes=[FLAT], trials=4)
    run("tiny.yaml", "--junitxml", "out.xml", "-o", "junit_family=xunit1")
    scene, verdict = ET.parse(pytester.path / "out.xml").iter("testcase")
    assert (scene.get("classname"), scene.get("name")) == ("tiny.yaml", FLAT)
    assert (scene.get("file"), scene.get("line")) == ("tiny.yaml", "7"), "counted from 0"
    message = scene.find("failure").get("message")
    assert message.startswith(f"{FLAT}: below the bar 0.9 by itself")
    assert "\n" not in message
    assert "nw-eval replay " in scene.find("failure").text
    properties = {each.get("name"): each.get("value") for each in verdict.iter("property")}
    assert (properties["verdict"], properties["trials"], properties["bar"]) == (
        "REGRESSED",
        "4",
        "0.9",
    )
    assert properties["report"].endswith("/report.md")
    properties = {each.get("name"): each.get("value") for each in scene.iter("property")}
    assert (properties["state"], float(properties["success"])) == ("failed", 0.0)


def test_scenes_that_regress_together_fail_where_the_verdict_is_not_a_test(suite, run, folders):
    suite(scenes=[FLAT, HURDLE, LOGS], trials=2)
    done = run("tiny.yaml", "-v", "-k", "flat or one_low")
    done.assert_outcomes(failed=2, deselected=2)
    done.stdout.fnmatch_lines([f"FAILED tiny.yaml::{FLAT} - {FLAT}: not decided*"])
    done.stdout.fnmatch_lines([f"{FLAT}: not decided: success 0.000, completed 0 of 2 trials; *"])
    done.stdout.fnmatch_lines(["REGRESSED * completed 0 of 4 trials in 2 of the suite's 3 scenes*"])
    (folder,) = folders()
    assert {row.scene for row in api.report(folder).rows} == {FLAT, HURDLE}


def test_scenes_fail_together_where_all_of_them_run_and_the_verdict_is_deselected(suite, run):
    suite(scenes=[FLAT, HURDLE], trials=2)
    run("tiny.yaml", "-k", "not verdict").assert_outcomes(failed=2, deselected=1)


@pytest.mark.parametrize(
    ("scenes", "trials", "gate", "verdict", "result"),
    [
        # Two trials say too little of either scene alone, and enough of both.
        ([FLAT, HURDLE], 2, "gate: {success_rate: 0.9}", "failed", "skipped"),
        ([FLAT], 1, "gate: {success_rate: 0.9}", "failed", "skipped"),
        ([FLAT], 1, "", "passed", "skipped"),
        ([FLAT], 4, "gate: {success_rate: 0.9}", "failed", "failed"),
        (
            [FLAT, HURDLE],
            4,
            f"gate: {{success_rate: 0.9, tiers: {{{FLAT}: informational}}}}",
            "failed",
            "mixed",
        ),
    ],
)
def test_pytest_and_junit_say_the_same_of_every_scene_and_no_scene_at_zero_passes(
    suite, run, pytester, folders, scenes, trials, gate, verdict, result
):
    suite(scenes=scenes, trials=trials, gate=gate)
    run("tiny.yaml", "--junitxml", "out.xml")
    (folder,) = folders()
    judged = api.report(folder)
    by_junit = results(ET.fromstring(junit_xml_of(judged)), lambda case: case.get("name"))
    by_pytest = results(ET.parse(pytester.path / "out.xml"), lambda case: case.get("name"))
    assert by_junit.pop("verdict") == by_pytest.pop("verdict") == (verdict, None)
    assert by_junit == by_pytest
    assert set(by_pytest) == set(scenes)
    if result == "mixed":
        assert [by_pytest[scene][0] for scene in scenes] == ["skipped", "failed"]
        assert by_pytest[FLAT][1].startswith("informational, not judged")
    else:
        assert {word for word, _ in by_pytest.values()} == {result}
    for word, message in by_pytest.values():
        if word == "skipped":
            assert f"success 0.000, completed 0 of {trials} trial" in message


def junit_xml_of(judged):
    return junit_xml(judged.info, judged.rows, judged.verdict, judged.typed_folder, None)


def results(document, name):
    """Return the result of each case, and the message of those that are skipped, by its name."""
    words = {"failure": "failed", "error": "error", "skipped": "skipped"}
    found = {}
    for case in document.iter("testcase"):
        ended = [each for each in case if each.tag in words]
        word = words[ended[0].tag] if ended else "passed"
        message = ended[0].get("message") if word == "skipped" else None
        found[name(case)] = (word, message)
    return found


@pytest.mark.parametrize(
    ("arguments", "outcomes"),
    [
        ([], {"failed": 1, "skipped": 1}),
        (["-o", "nw_inconclusive=xfail"], {"xfailed": 1, "skipped": 1}),
        pytest.param(
            ["-o", "nw_inconclusive=xfail", "--runxfail"],
            {"failed": 1, "skipped": 1},
            marks=pytest.mark.nightly,
        ),
        (["-o", "nw_inconclusive=pass"], {"passed": 1, "skipped": 1}),
    ],
)
def test_an_inconclusive_verdict_is_what_the_ini_file_says(suite, run, arguments, outcomes):
    suite()  # One trial cannot show that the bar is not reached.
    done = run("tiny.yaml", "-rx", *arguments)
    done.assert_outcomes(**outcomes)
    done.stdout.fnmatch_lines(["tiny.yaml: INCONCLUSIVE *"])
    if "xfailed" in outcomes:
        done.stdout.fnmatch_lines(["XFAIL tiny.yaml::verdict - INCONCLUSIVE *"])


def test_a_trial_without_a_result_is_an_error_of_its_scene_and_of_the_verdict(
    suite, run, monkeypatch
):
    opened = trial.open_trial

    def open_one(job, *rest):
        if job.trial.scene == HURDLE:
            raise RuntimeError("\x1b[31mno \u202eroom\n::error::x")
        return opened(job, *rest)

    monkeypatch.setattr(trial, "open_trial", open_one)
    suite(scenes=[FLAT, HURDLE])
    done = run("tiny.yaml")
    done.assert_outcomes(skipped=1, errors=2)
    done.stdout.fnmatch_lines(
        [
            "*ERROR at setup of tiny.yaml: hurdles/one_low_carpet*",
            f"{HURDLE}: 1 trial ended in errors; no trial has a result",
            "INFRASTRUCTURE *",
            f"ERROR tiny.yaml::{HURDLE} - {HURDLE}: 1 trial end*",
            "ERROR tiny.yaml::verdict - INFRASTRUCTURE *",
        ]
    )
    whole = done.stdout.str()
    assert "Traceback" not in whole
    assert "\x1b" not in whole
    assert "\u202e" not in whole
    assert r"\u202eroom" in whole
    assert not any(line.startswith("::error") for line in done.outlines)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--nw-policy", "go1-parkur"], "*unknown policy 'go1-parkur'*go1-parkour*"),
        (["--nw-baseline", "nobody"], "*suite 'tiny' has no baseline 'nobody'*"),
        (["--nw-report-dir", "tiny.yaml"], "*no folder can be made at *tiny.yaml*"),
    ],
)
def test_what_cannot_be_run_is_an_error_of_every_test_in_a_line(
    suite, run, folders, arguments, sentence
):
    suite()
    done = run("tiny.yaml", *arguments)
    done.assert_outcomes(errors=2)
    done.stdout.fnmatch_lines(["*ERROR at setup of tiny.yaml: verdict*", sentence])
    assert "Traceback" not in done.stdout.str()
    assert "During handling" not in done.stdout.str()
    assert folders() == []


def test_ctrl_c_ends_the_session_and_says_how_the_run_continues(
    suite, pytester, monkeypatch, folders
):
    opened = trial.open_trial

    def open_and_interrupt(job, *rest):
        os.kill(os.getpid(), signal.SIGINT)
        return opened(job, *rest)

    monkeypatch.setattr(trial, "open_trial", open_and_interrupt)
    monkeypatch.setattr(api, "run", partial(api.run, in_process=True))
    suite(trials=3)
    done = pytester.runpytest_inprocess(
        "-p", "nw_eval.pytest_plugin", "tiny.yaml", no_reraise_ctrlc=True
    )
    assert done.ret == pytest.ExitCode.INTERRUPTED
    done.stdout.fnmatch_lines(["*interrupted; continue with nw-eval run --resume reports/tiny-*"])
    (folder,) = folders()
    assert 0 < len(api.report(folder).rows) < 3, "what had ended is kept"


def test_a_baseline_is_saved_for_a_review_and_passes_once_it_is_there(
    suite, run, pytester, monkeypatch, folders, other
):
    monkeypatch.setattr(baselines_saved, "starts_for", lambda _: 1)
    carry_out = session.carry_out
    monkeypatch.setattr(
        session,
        "carry_out",
        lambda plan, how, **words: carry_out(plan, replace(how, in_process=True), **words),
    )
    suite(gate="gate: {max_drop: 0.1, rounds: 1, least_starts: 1}")
    arguments = ("tiny.yaml", "-v", "-rfs", "--nw-update-baseline")
    first = run(*arguments)
    first.assert_outcomes(skipped=1, failed=1)
    baseline = "reports/baselines/tiny/stand.parquet"
    first.stdout.fnmatch_lines(
        [
            f"{baseline} is new: stand, 1 initial state in each scene",
            "Check what has changed, commit it, and run again without --nw-update-baseline.",
            f"FAILED tiny.yaml::verdict - {baseline} is new*",
            "SKIPPED * the baseline is being saved",
        ]
    )
    content = (pytester.path / baseline).read_bytes()
    run(*arguments).assert_outcomes(skipped=1, passed=1)
    assert (pytester.path / baseline).read_bytes() == content

    same = run("tiny.yaml", "--nw-baseline", "stand")
    same.assert_outcomes(passed=2)
    same.stdout.fnmatch_lines(["tiny.yaml: PASS * same policy as baseline stand*"])
    (judged,) = [api.report(folder) for folder in folders() if (folder / "bank").exists()]
    assert len(judged.rows) == 1, "one start of its only scene ran again"

    worse = run("tiny.yaml", "--nw-baseline", "stand", "--nw-policy", other)
    worse.assert_outcomes(errors=2)
    worse.stdout.fnmatch_lines(["*no policy can be worse by max_drop 0.1*"])


@pytest.mark.parametrize(("arguments", "cache"), [((), True), (("--nw-no-cache",), False)])
def test_results_of_earlier_runs_are_reused_unless_that_is_turned_off(
    suite, run, monkeypatch, arguments, cache
):
    asked_for, real = [], api.run

    def begin(*request, **options):
        asked_for.append(options["cache"])
        return real(*request, **options)

    monkeypatch.setattr(api, "run", begin)
    suite(gate="")
    run("tiny.yaml", *arguments).assert_outcomes(passed=1, skipped=1)
    assert asked_for == [cache]


RERUNS = """\
import pytest
from _pytest.runner import runtestprotocol


def pytest_runtest_protocol(item, nextitem):
    for _ in range(2):  # As pytest-rerunfailures does: the first failure is logged as a rerun.
        for report in runtestprotocol(item, nextitem=nextitem, log=False):
            if report.failed and _ == 0:
                report.outcome = "rerun"
            item.ihook.pytest_runtest_logreport(report=report)
    return True
"""


def test_a_plugin_that_runs_failures_again_does_not_run_a_suite_again(suite, run, pytester):
    suite(scenes=[FLAT], trials=4)
    pytester.makeconftest(RERUNS)
    pytester.makepyfile("def test_own(): assert 0")
    run("tiny.yaml", "test_a_plugin_that_runs_failures_again_does_not_run_a_suite_again.py",
        "--junitxml", "out.xml")  # fmt: skip
    cases = [
        (case.get("name"), case.find("failure") is None)
        for case in ET.parse(pytester.path / "out.xml").iter("testcase")
    ]
    assert cases == [(FLAT, False), ("verdict", False), ("test_own", True), ("test_own", False)]


def test_a_ladder_of_the_gate_is_a_test_of_its_own(suite, run):
    gate = "gate: {success_rate: 0.05, confidence: 0.6, limits: {stairs/up: {at_least: 0.1}}}"
    suite(scenes=[FLAT], trials=2, gate=gate)
    done = run("tiny.yaml", "-v", "--nw-policy", "stand")
    done.stdout.fnmatch_lines(
        [
            "tiny.yaml::stairs/up FAILED*",
            "*_ tiny.yaml: stairs/up _*",
            "stairs/up: the limit is below 0.1 m, shown by * trials",
        ]
    )


def test_a_ladder_that_is_not_judged_is_skipped(suite, run):
    suite(scenes=[FLAT], gate="gate: {limits: {stairs/up: {max_drop: 0.1}}}")
    done = run("tiny.yaml", "-rs")
    done.stdout.fnmatch_lines(["SKIPPED*stairs/up: max_drop is not judged without a baseline"])
