"""Which checkpoint of a series fell first, by real trials in one scene."""

import json
import shutil
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import numpy_helper

from nw_base.errors import IncomparableError, PolicyError, UsageError
from nw_eval import api
from nw_eval.api.series import _of_folders
from nw_eval.cli.verbs.bisect import series_json, series_page
from nw_policies import load_bundle

SUITE = """\
nw-eval: 1
name: one
robot: go1
policy: go1-parkour
trials: 2
seed: 7
episode: {duration: 8.0}
scenes: [hurdles/one_low_carpet]
gate: {success_rate: 0.5, max_drop: 0.3, rounds: 40, least_starts: 1}
"""


@pytest.fixture
def series(tmp_path, monkeypatch):
    """A good checkpoint, two copies of it, and two whose network answers nothing."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "one.yaml").write_text(SUITE)
    good = load_bundle("go1-parkour").checkpoint
    for name in ("good", "second", "third"):
        shutil.copy(good, tmp_path / f"{name}.onnx")
    graph = onnx.load(good)
    for weights in graph.graph.initializer:
        array = numpy_helper.to_array(weights)
        if array.dtype == np.float32:
            weights.CopyFrom(numpy_helper.from_array(np.zeros_like(array), weights.name))
    for name in ("fourth", "last"):
        onnx.save(graph, tmp_path / f"{name}.onnx")
    return ["second.onnx", "third.onnx", "fourth.onnx"]


@pytest.mark.slow
@pytest.mark.nightly
def test_the_first_checkpoint_that_fell_is_found_and_a_search_goes_on_where_it_was(series):
    heard = []
    settings = {"good": "good.onnx", "bad": "last.onnx", "baseline_trials": 60, "workers": 2}
    found = api.bisect(
        "one.yaml", series, progress=lambda name, word: heard.append((name, word)), **settings
    )
    assert heard == [
        ("last.onnx", "REGRESSED"), ("third.onnx", "PASS"), ("fourth.onnx", "REGRESSED"),
        ("second.onnx", "PASS"),
    ]  # fmt: skip
    assert found.found.last_good == 1
    assert list(found.found.suspects) == [2]
    assert found.exit_code == 1
    assert found.trials <= 60, "all four stop early"
    told = json.loads(series_json(found))
    assert (told["first_flagged"], told["last_passed"]) == ("fourth.onnx", "third.onnx")
    assert [each["verdict"] for each in told["checkpoints"]] == [
        "PASS", "PASS", "REGRESSED", "REGRESSED",
    ]  # fmt: skip
    page = series_page(found)
    interval = found.runs[2].verdict.against.interval
    assert (
        f"the first flagged: fourth.onnx, worse than the good one by {interval.low:.2f} (99 % "
        f"confidence) to {interval.high:.2f} (95 %)" in page
    )
    assert "the last before it that passed: third.onnx" in page
    again = api.bisect("one.yaml", series, **settings)
    assert again.baseline == found.baseline
    rows = [[row.state_digest for row in run.rows] for run in found.runs.values()]
    assert rows == [[row.state_digest for row in run.rows] for run in again.runs.values()]
    assert [run.info.started for run in again.runs.values()] == [
        run.info.started for run in found.runs.values()
    ]


@pytest.mark.slow
@pytest.mark.usefixtures("series")
def test_a_checkpoint_that_falls_by_a_gated_score_alone_is_flagged_and_the_score_is_named():
    """Stiffer servos walk as far for more than twice the power. Bars of scores are left out."""
    text = SUITE.partition("gate:")[0].replace("duration: 8.0", "duration: 3.0") + (
        "gate:\n  success_rate: 0.99\n  max_drop: 0.3\n  rounds: 16\n  least_starts: 1\n  scores:\n"
        "    mean_power: {max_drop: 60, range: [0, 300], bar: 1}\n"
        "    limit_time: {bar: 0.00001}\n"
    )
    Path("one.yaml").write_text(text)
    shutil.copytree(load_bundle("go1-parkour").folder, "stiff")
    card = Path("stiff/policy.yaml")
    card.write_text(
        card.read_text().replace("kp: 20", "kp: 30").replace("name: go1-parkour", "name: stiff")
    )
    found = api.bisect(
        "one.yaml", ["second.onnx"], good="good.onnx", bad="./stiff", baseline_trials=16, workers=2
    )
    assert dict(found.found.words) == {0: "PASS", 1: "REGRESSED"}
    assert found.exit_code == 1
    fallen = found.runs[1].verdict
    assert fallen.against.word == "PASS", "by success alone it would not be flagged"
    assert [(item.spec.name, item.bar) for item in fallen.scores] == [("mean_power", None)]
    page = series_page(found)
    assert "the first flagged: ./stiff; mean_power " in page
    (line,) = [line for line in page.splitlines() if line.startswith("2  ./stiff")]
    assert line.split()[2] == "REGRESSED"
    assert line.endswith("mean_power")


@pytest.mark.slow
@pytest.mark.usefixtures("series")
@pytest.mark.nightly
def test_a_checkpoint_whose_limit_alone_is_lower_is_flagged_by_the_ladder():
    text = SUITE.partition("gate:")[0] + (
        "gate:\n  max_drop: 0.5\n  rounds: 4\n  least_starts: 1\n  limits:\n"
        "    stairs/up: {max_drop: 0.04, at_least: 0.34}\n"
    )
    Path("one.yaml").write_text(text)
    shutil.copytree(load_bundle("go1-parkour").folder, "soft")
    card = Path("soft/policy.yaml")
    card.write_text(
        card.read_text().replace("kp: 20", "kp: 16").replace("name: go1-parkour", "name: soft")
    )
    found = api.bisect(
        "one.yaml", ["second.onnx"], good="good.onnx", bad="./soft", baseline_trials=16, workers=2
    )
    (line,) = [line for line in series_page(found).splitlines() if line.startswith("2  ./soft")]
    assert "REGRESSED" in line
    assert line.endswith("stairs/up")


def test_what_is_no_checkpoint_is_refused_before_anything_runs(series):
    with pytest.raises(PolicyError, match=r"fifth\.onnx"):
        api.bisect("one.yaml", [*series, "fifth.onnx"], good="good.onnx", bad="last.onnx")


@pytest.mark.slow
def test_a_baseline_of_that_name_that_is_of_another_checkpoint_is_not_taken_for_the_good_one(
    series,
):
    api.save_baseline("one.yaml", checkpoint="last.onnx", name="good", trials=1)
    with pytest.raises(
        IncomparableError, match=r"good\.parquet is there already, and is not a baseline"
    ):
        api.bisect("one.yaml", series, good="good.onnx", bad="last.onnx", baseline_trials=1)


def test_a_trainings_folder_stands_for_its_checkpoints_between_the_two_ends(tmp_path):
    for step in (5, 100, 20, 3000, 400):
        (tmp_path / f"model_{step}.onnx").write_bytes(b"")
    series = _of_folders([tmp_path], tmp_path / "model_20.onnx", tmp_path / "model_3000.onnx")
    assert series == [tmp_path / "model_100.onnx", tmp_path / "model_400.onnx"]
    (tmp_path / "empty").mkdir()
    with pytest.raises(UsageError, match="no card and no checkpoint"):
        _of_folders([tmp_path / "empty"], "good", "bad")


def test_a_held_out_baseline_meets_its_own_policy_as_any_candidate(tmp_path, monkeypatch):
    """It is of other initial states, so that re-running a few of them would show nothing."""
    monkeypatch.chdir(tmp_path)
    text = SUITE.replace("max_drop: 0.3, rounds: 40", "max_drop: 0.6, rounds: 20")
    Path("one.yaml").write_text(text.replace("success_rate: 0.5, ", ""))
    api.save_baseline("one.yaml", name="apart", trials=20, held_out=True, workers=2)
    judged = api.run("one.yaml", baseline="apart", workers=2)
    assert (judged.verdict.verdict, judged.verdict.against.basis) == ("PASS", "fresh")
    assert judged.verdict.against.again is None
    assert 1 < len(judged.rows) < 20
