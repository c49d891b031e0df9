"""The main job from a suite file to a verdict, in real processes; no splats, so it is quick."""

import json
from importlib.util import find_spec

import pytest

from nw_base.errors import (
    IncomparableError,
    PrerequisiteError,
    SuiteError,
    UsageError,
)
from nw_eval import api
from nw_eval.cli.verbs.check import forecast_page
from nw_eval.cli.verbs.options import summary
from nw_gate.results.parquet import read_rows

SUITE = """\
nw-eval: 1
name: quick
robot: go1
policy: {policy}
trials: {trials}
seed: 5
episode: {{duration: {duration}}}
scenes: [{scenes}]
record: none
gate: {{success_rate: {bar}}}
"""


@pytest.fixture
def suite(tmp_path, monkeypatch):
    """Return a writer of suite files in an empty working folder."""
    monkeypatch.chdir(tmp_path)

    def write(
        *, policy="go1-parkour", trials=2, duration=12.0, scenes="hurdles/three_low", bar=0.3
    ):
        path = tmp_path / "quick.yaml"
        path.write_text(
            SUITE.format(policy=policy, trials=trials, duration=duration, scenes=scenes, bar=bar)
        )
        return path

    return write


def test_the_shipped_policy_passes_low_bars_and_leaves_the_evidence(suite, tmp_path):
    # Its README: 0.96 to 1.00 of the waypoints for bars up to 0.25 m.
    ran = api.run(suite(trials=4, scenes="hurdles/three_low, hurdles/one_low_carpet"))
    assert ran.verdict.verdict == "PASS"
    assert ran.verdict.success >= 0.9
    assert ran.exit_code == 0
    assert ran.folder.parent == tmp_path / "reports"
    for name in ("run.json", "journal.jsonl", "trials.parquet", "report.md"):
        assert (ran.folder / name).is_file()
    assert (ran.folder / "report.md").read_text().startswith("# PASS")
    panels = json.loads((ran.folder / "foxglove.json").read_text())["configById"]
    assert panels["Image!0"] == {"imageMode": {"imageTopic": "/camera/ego"}}
    rows, metadata = read_rows(ran.folder / "trials.parquet")
    assert len(rows) == 8
    assert (
        metadata["rows_digest"] == json.loads((ran.folder / "run.json").read_text())["rows_digest"]
    )
    assert "PASS" in summary(ran)


def test_a_policy_that_does_nothing_scores_zero_and_is_convicted(suite):
    ran = api.run(suite(policy="stand", trials=4, bar=0.9))
    assert ran.verdict.success == 0.0
    assert {row.outcome for row in ran.rows} == {"stuck"}
    assert ran.verdict.verdict == "REGRESSED"
    assert ran.exit_code == 1


def test_another_policy_does_not_resume_a_run(suite, tmp_path):
    path = suite(trials=1, duration=1.0)
    api.run(path, out=tmp_path / "run")
    with pytest.raises(IncomparableError, match="policy"):
        api.run(path, policy="stand", resume=tmp_path / "run")


@pytest.mark.parametrize(
    ("settings", "error", "said"),
    [
        ({"trials": 0}, SuiteError, "quick.yaml:5:1: trials"),
        ({"scenes": "hurdles/three_lo"}, SuiteError, "did you mean 'hurdles/three_low'"),
        ({"scenes": "./nowhere"}, SuiteError, "quick.yaml:8:10: no scene matches './nowhere'"),
        ({"policy": "go1-parkur"}, SuiteError, "quick.yaml:4:1: unknown policy 'go1-parkur': no"),
    ],
)
def test_what_cannot_be_run_is_told_before_anything_runs(suite, tmp_path, settings, error, said):
    with pytest.raises(error, match=said.replace(".", r"\.")):
        api.run(suite(**settings))
    assert not (tmp_path / "reports").exists()


def test_a_scene_filter_that_matches_nothing_names_the_nearest_scene(suite):
    with pytest.raises(UsageError, match="hurdles/three_low"):
        api.run(suite(), scenes=("three_low",))


@pytest.mark.skipif(find_spec("gsplat") is not None, reason="gsplat is installed here")
def test_a_renderer_that_is_not_installed_is_told_before_anything_runs(suite, tmp_path):
    path = suite()
    path.write_text(path.read_text().replace("record: none", "record: all"))
    with pytest.raises(PrerequisiteError, match="gsplat"):
        api.run(path, render="cuda")
    assert not (tmp_path / "reports").exists()


@pytest.mark.parametrize(
    ("option", "said"),
    [
        ({"workers": 2}, "--workers 2 with --in-process"),
        ({"time_limit": 9.0}, "--time-limit 9 cannot be enforced with --in-process"),
        ({"memory_limit": "2GB"}, "--memory-limit 2GB cannot be enforced with --in-process"),
    ],
)
def test_what_one_process_cannot_do_is_refused(suite, tmp_path, option, said):
    with pytest.raises(UsageError, match=said):
        api.run(suite(), in_process=True, **option)
    assert not (tmp_path / "reports").exists()


def test_no_workers_are_refused(suite):
    with pytest.raises(UsageError, match="give at least 1"):
        api.run(suite(), workers=0)
    with pytest.raises(UsageError, match="give at least 1"):
        api.check(suite(), workers=0)


def test_check_says_what_would_run_and_runs_nothing(suite, tmp_path):
    forecast = api.check(suite(trials=3), workers=2)
    assert [(scene.name, scene.trials) for scene in forecast.scenes] == [("hurdles/three_low", 3)]
    assert (forecast.trials, forecast.workers, forecast.policy.name) == (3, 2, "go1-parkour")
    # 0.06 s for each of 12 s of 300 trials, on two workers that start in 4 s.
    many = api.check(suite(trials=300), workers=2)
    assert many.minutes == pytest.approx((4 + 0.06 * 12 * 300 / 2) / 60)
    told = forecast_page(forecast)
    assert "3 of 12 s: 1 scene," in told
    assert "hurdles/three_low" in told
    assert "minutes" in told
    assert not (tmp_path / "reports").exists()


def test_the_report_of_a_run_can_be_written_again(suite, tmp_path):
    ran = api.run(suite(trials=1, duration=1.0))
    again = api.report(ran.folder, out=tmp_path / "copy.md")
    assert again.verdict == ran.verdict
    assert (tmp_path / "copy.md").read_text() == (ran.folder / "report.md").read_text()
