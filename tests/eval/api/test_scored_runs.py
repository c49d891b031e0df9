"""A suite with scores from its file to its pages."""

from dataclasses import replace
from html import unescape

import pytest

from nw_base.errors import UsageError
from nw_eval import api
from nw_eval.reporting.junit import junit_xml
from nw_gate.results.baseline_file import read_baseline, write_baseline
from nw_gate.results.parquet import read_rows

SUITE = """
nw-eval: 1
name: scored
robot: go1
policy: stand
trials: 2
seed: 1
episode: {duration: 0.4}
scenes: [hurdles/one_low_carpet]
record: none
scores: [mean_power, base_roll_rms, time_to_finish]
gate:
  scores:
    foot_slip: {bar: 0.9}
    mean_power: {bar: 0.001, range: [0, 0.01]}
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scored.yaml").write_text(SUITE)
    return tmp_path


def test_scores_are_in_rows_and_on_every_page(folder):
    api.run("scored.yaml", out=folder / "run", workers=1)
    rows, _ = read_rows(folder / "run" / "trials.parquet")
    assert [set(dict(row.scores)) for row in rows] == [
        {"mean_power", "base_roll_rms", "foot_slip"}
    ] * 2, "a robot that stands finishes nothing"
    report = api.report(folder / "run")
    by_name = {item.spec.name: item for item in report.verdict.scores}
    assert list(by_name) == ["mean_power", "base_roll_rms", "time_to_finish", "foot_slip"]
    measured = [dict(row.scores)["base_roll_rms"] for row in rows]
    assert report.scores["base_roll_rms"].mean == pytest.approx(sum(measured) / 2)
    assert report.scores == by_name
    assert by_name["time_to_finish"].undefined == 2
    assert by_name["time_to_finish"].mean == 60.0
    assert by_name["mean_power"].word is not None
    assert by_name["base_roll_rms"].word is None
    page = (folder / "run" / "report.md").read_text()
    html = (folder / "run" / "report.html").read_text()
    for item in by_name.values():
        assert item.spec.name in page
        assert item.spec.meaning in unescape(html)
    junit = junit_xml(report.info, report.rows, report.verdict, folder / "run", None).decode()
    assert f'name="score_foot_slip" value="{by_name["foot_slip"].mean:.6g}"' in junit
    assert 'name="score_mean_power_verdict"' in junit
    again = api.judge(folder / "run")
    assert again.verdict.scores == report.verdict.scores


def test_a_drop_of_a_score_that_no_baseline_is_there_for_is_said_not_to_be_judged(folder):
    (folder / "scored.yaml").write_text(
        SUITE.partition("gate:")[0] + "gate: {scores: {mean_power: {max_drop: 100}}}\n"
    )
    report = api.run("scored.yaml", out=folder / "run", workers=1)
    said = "mean_power: max_drop 100 was ignored, there is no baseline"
    assert said in report.verdict.reasons
    assert said in (folder / "run" / "report.md").read_text()


@pytest.mark.slow
def test_the_baselines_own_policy_is_invalid_where_the_baseline_lacks_a_gated_score(folder):
    head = SUITE.partition("scores:")[0].replace("policy: stand", "policy: go1-parkour")
    head = head.replace("duration: 0.4", "duration: 3.0")  # Half of the waypoints.
    gate = "gate:\n  max_drop: 0.3\n  rounds: 2\n"
    (folder / "scored.yaml").write_text(head + gate)
    saved = api.save_baseline("scored.yaml", trials=2, workers=1)
    same = api.run("scored.yaml", baseline=str(saved.file), out=folder / "same", workers=1)
    assert (same.verdict.verdict, same.verdict.against.basis) == ("PASS", "same")
    (folder / "scored.yaml").write_text(head + gate + "  scores: {mean_power: {max_drop: 60}}\n")
    report = api.run("scored.yaml", baseline=str(saved.file), out=folder / "run", workers=1)
    assert (report.verdict.verdict, report.exit_code) == ("INVALID", 5)
    assert report.verdict.against.basis == "same"
    (told,) = [each for each in report.verdict.reasons if "has no mean_power" in each]
    assert "nw-eval baseline save" in told


@pytest.mark.slow
def test_a_baseline_whose_scores_were_changed_is_invalid_for_its_own_policy(folder):
    head = SUITE.partition("scores:")[0].replace("policy: stand", "policy: go1-parkour")
    gate = "gate:\n  max_drop: 0.3\n  rounds: 2\n  scores: {mean_power: {max_drop: 60}}\n"
    (folder / "scored.yaml").write_text(head + gate)
    saved = api.save_baseline("scored.yaml", trials=2, workers=1)
    honest = read_baseline(saved.file)
    (panel,) = honest.panels
    doubled = tuple(
        replace(start, scores=tuple((name, 2.0 * value) for name, value in start.scores))
        for start in panel.starts
    )
    saved.file.unlink()
    write_baseline(saved.file, replace(honest, panels=(replace(panel, starts=doubled),)))
    report = api.run("scored.yaml", baseline=str(saved.file), out=folder / "run", workers=1)
    assert (report.verdict.verdict, report.exit_code) == ("INVALID", 5)
    told = [each for each in report.verdict.reasons if "mean_power" in each]
    assert "start 0: mean_power " in told[0]
    assert ", the baseline's " in told[0]


def test_a_run_that_fails_removes_its_own_earlier_comment_and_no_file_of_the_users(folder):
    where = api.Surfaces(comment=folder / "notes.md")
    error = UsageError("no such suite")
    (folder / "notes.md").write_text("my notes")
    api.publish_error(error, "scored", where)
    assert (folder / "notes.md").read_text() == "my notes"
    report = api.run("scored.yaml", out=folder / "run", workers=1)
    api.publish(report, where)
    assert (folder / "notes.md").read_text() != "my notes"
    api.publish_error(error, "scored", where)
    assert not (folder / "notes.md").exists()


def test_no_surface_takes_the_place_of_a_file_of_the_run_itself(folder):
    report = api.run("scored.yaml", out=folder / "run", workers=1)
    before = (folder / "run" / "run.json").read_bytes()
    shown = api.publish(report, api.Surfaces(junit=folder / "run" / "run.json"))
    assert "run.json is a file of the run itself" in shown.warnings[0]
    assert (folder / "run" / "run.json").read_bytes() == before
    assert not api.publish(report, api.Surfaces(junit=folder / "run" / "junit.xml")).warnings
