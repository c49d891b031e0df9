"""What runs for those tests that are asked for, and how often: alone, and in many processes."""

import json
import signal
import subprocess
import sys
import textwrap
from pathlib import Path
from types import SimpleNamespace

import pytest

from nw_eval import api
from nw_eval.pytest_plugin.options import SETTINGS
from nw_eval.pytest_plugin.runs import Runs, locked
from nw_gate.results.provenance import write_run_info
from nw_gate.results.request import Request

FLAT, HURDLE, LOGS = "flat/carpet_room", "hurdles/one_low_carpet", "hurdles/two_logs_park"


@pytest.fixture
def ran(folders):
    """Return a function that lists what runs have run since it was last asked: their scenes."""
    known = set()

    def new():
        fresh = [folder for folder in folders() if folder not in known]
        known.update(fresh)
        return [set(json.loads((each / "run.json").read_text())["scenes"]) for each in fresh]

    return new


@pytest.mark.parametrize("arguments", [("-k", "one_low"), (f"tiny.yaml::{HURDLE}",)])
def test_a_scene_that_is_asked_for_runs_alone(suite, run, ran, arguments):
    suite(scenes=[FLAT, HURDLE])
    named = () if arguments[0].startswith("tiny") else ("tiny.yaml",)
    run(*arguments, *named).assert_outcomes(skipped=1, deselected=2 if named else 0)
    assert ran() == [{HURDLE}]


def test_a_verdict_that_is_asked_for_takes_every_scene(suite, run, ran):
    suite(scenes=[FLAT, HURDLE])
    run("tiny.yaml::verdict").assert_outcomes(failed=1)
    run("tiny.yaml", "-k", "verdict or one_low").assert_outcomes(skipped=1, failed=1, deselected=1)
    assert ran() == [{FLAT, HURDLE}] * 2


def test_last_failed_runs_the_scenes_that_failed_and_then_the_verdict(suite, run, ran):
    """One scene fails with the verdict, then with a better policy neither."""
    tiers = "{success_rate: 0.9, tiers: {hurdles/one_low_carpet: critical, '*': informational}}"
    suite(scenes=[FLAT, HURDLE, LOGS], trials=4, gate=f"gate: {tiers}")
    run("tiny.yaml").assert_outcomes(failed=2, skipped=2)
    assert ran() == [{FLAT, HURDLE, LOGS}]
    suite(scenes=[FLAT, HURDLE, LOGS], gate="")
    run("tiny.yaml", "--lf").assert_outcomes(skipped=1, deselected=3)
    assert ran() == [{HURDLE}]
    run("tiny.yaml", "--lf").assert_outcomes(passed=1, deselected=3)
    assert ran() == [{FLAT, HURDLE, LOGS}]


@pytest.mark.nightly
def test_options_have_twins_in_the_ini_file_and_win_over_them(suite, run, pytester, folders, other):
    suite("deep/tiny.nw.yaml", trials=3)
    pytester.makeini(f"""
        [pytest]
        nw_policy = {other}
        nw_rounds = 2
        nw_report_dir = out/reports
    """)
    pytester.chdir()
    run("deep/tiny.nw.yaml")
    (folder,) = (pytester.path / "out" / "reports").iterdir()
    judged = api.report(folder)
    assert (judged.info.policy.name, len(judged.rows)) == ("other", 2)
    run("deep/tiny.nw.yaml", "--nw-policy=stand", "--nw-rounds=1", "--nw-report-dir=reports")
    (folder,) = folders()
    judged = api.report(folder)
    assert (judged.info.policy.name, len(judged.rows)) == ("stand", 1)


@pytest.mark.nightly
def test_workers_of_xdist_share_one_run(suite, pytester, folders, in_process_conftest):
    suite(scenes=[FLAT, HURDLE, LOGS], trials=4)
    done = pytester.runpytest_subprocess(*in_process_conftest, "-n", "2", "-v", "tiny.yaml")
    done.assert_outcomes(failed=4)
    done.stdout.fnmatch_lines(
        [
            "REGRESSED * completed 0 of 12 trials in 3 scenes *",
            "nw-eval replay reports/tiny-*.mcap",
            "tiny.yaml: REGRESSED * report: reports/tiny-*/report.md",
        ]
    )
    ended = {line.split()[0] for line in done.outlines if "] [" in line}
    assert ended == {"[gw0]", "[gw1]"}, "both had tests of the suite"
    (folder,) = folders()
    assert len(api.report(folder).rows) == 12


def test_a_lock_is_free_again_once_its_process_was_killed(tmp_path):
    holder = textwrap.dedent("""
        import sys, time
        from pathlib import Path
        from nw_eval.pytest_plugin.runs import locked
        with locked(Path(sys.argv[1])):
            print("held", flush=True)
            time.sleep(60)
    """)
    line = [sys.executable, "-c", holder, str(tmp_path / "lock")]
    with subprocess.Popen(line, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "held\n"
        process.send_signal(signal.SIGKILL)
        with locked(tmp_path / "lock"):
            assert process.wait() == -signal.SIGKILL


@pytest.mark.usefixtures("run")
def test_a_worker_goes_on_with_the_run_of_one_that_was_killed(suite, folders):
    """The second worker finds the first one's folder: with trials, and without an end."""
    suite(trials=3)
    stash = pytest.Stash()
    stash[SETTINGS] = SimpleNamespace(report_dir=Path("reports"), workers=None, cache=False)
    workerinput = {"workercount": 2, "nw_eval_session": "20260101T000000Z chance"}
    first, second, third = (
        Runs(SimpleNamespace(stash=stash, workerinput=workerinput)) for _ in range(3)
    )
    request = Request(suite=Path("tiny.yaml"))
    whole = first.of(request)
    assert first.of(request) is whole
    (folder,) = folders()

    journal = folder / "journal.jsonl"
    journal.write_bytes(b"".join(journal.read_bytes().splitlines(keepends=True)[:-1]))
    (folder / "trials.parquet").unlink()
    info = whole.info.model_copy(update={"finished": None, "rows_digest": "", "trials_sha256": ""})
    write_run_info(folder / "run.json", info)
    again = second.of(request)
    assert [row.digest for row in again.rows] == [row.digest for row in whole.rows]
    before = (folder / "journal.jsonl").stat().st_mtime_ns
    assert third.of(request).verdict == whole.verdict
    assert (folder / "journal.jsonl").stat().st_mtime_ns == before, "there was nothing to run"
    assert folders() == [folder]
