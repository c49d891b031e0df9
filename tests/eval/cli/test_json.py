"""`--json`: one JSON document on standard output, and nothing else."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from command_line import ends

from nw_eval.api import BisectedSeries, WatchedCheckpoint, WatchedTraining
from nw_eval.cli.verbs import forms
from nw_eval.cli.verbs.bisect import series_json
from nw_eval.cli.verbs.help import options_of
from nw_gate.bisection import Bisection

BAR = """\
nw-eval: 1
name: bar
robot: go1
policy: stand
trials: 40
seed: 7
episode: {duration: 0.2}
scenes: [flat/carpet_room]
gate: {success_rate: 0.7}
"""
LISTS = {
    "suites": "smoke",
    "policies list": "go1-parkour",
    "robots list": "go2",
    "scenes list": "flat/carpet_room",
    "baseline list": "go1-act-rgb",
    "sensors --list": "proprio",
}
SHOWN = {
    "policies show go1-parkour": ("card", "terms"),
    "robots show go1": ("joints", "feet"),
    "scenes show flat/carpet_room": ("digest", "trail"),
    "baseline show hurdles/go1-act-rgb": ("file", "baseline"),
    "cache info": ("entries", "bytes"),
}
JUDGES = ("run", "gate", "merge", "report", "compare", "sim2real", "ledger", "verify")
CHECKS = (
    *("check", "policies check", "robots check", "scenes check"),
    *("baseline check", "baseline verify"),
)


def printed(capsys: pytest.CaptureFixture[str], *words: str) -> object:
    capsys.readouterr()
    ends(*words, "--json")
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("command", LISTS)
def test_a_list_is_an_array_of_objects_with_names(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    found = printed(capsys, *command.split())
    assert isinstance(found, list)
    assert LISTS[command] in [each["name"] for each in found]


@pytest.mark.parametrize("command", SHOWN)
def test_what_is_shown_is_an_object(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    found = printed(capsys, *command.split())
    assert isinstance(found, dict)
    assert found.keys() >= set(SHOWN[command])


def test_every_verb_that_lists_checks_or_judges_has_it() -> None:
    has = {name for name, form in forms() if any(o.name == "json" for o in options_of(form))}
    lists = {command.removesuffix(" --list") for command in LISTS}
    others = ("baseline diff", "splat info", "plan", "scores", "bisect", "watch")
    assert has >= {*lists, *JUDGES, *CHECKS, *others}


def test_what_would_run_is_an_object_with_the_numbers_of_the_page(
    capsys: pytest.CaptureFixture[str],
) -> None:
    found = printed(capsys, "check", "smoke", "--trials", "3")
    assert isinstance(found, dict)
    assert (found["suite"], found["policy"], found["trials"]) == ("smoke", "go1-parkour", 6)
    assert [each["trials"] for each in found["scenes"]] == [3, 3]
    assert ends("check", "smoke", "--trials", "3") == 0
    page = capsys.readouterr().out
    assert found["suite_digest"][:16] in page
    assert f"about {found['minutes']:.1f} minutes" in page


def test_a_plan_of_trials_is_an_object_with_a_point_for_each_drop(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    words = ("hurdles", "--baseline", "go1-act-rgb", "--detect", "0.2")
    found = printed(capsys, "plan", *words)
    assert isinstance(found, dict)
    assert found["flagged_within"]["0.8"] <= found["flagged_within"]["0.9"] < found["most_trials"]
    assert found["curve"][0]["drop"] == 0.0
    assert all(
        each["passed"] + each["regressed"] + each["undecided"] == pytest.approx(1.0)
        for each in found["curve"]
    )
    Path("bar.yaml").write_text(BAR)
    bar = printed(capsys, "plan", "bar.yaml")
    assert isinstance(bar, dict)
    assert bar["needed"] in bar["sizes"]
    assert [len(each["passed"]) for each in bar["curve"]] == [len(bar["sizes"])] * len(bar["curve"])


def test_a_series_is_an_object_with_a_checkpoint_for_each_place() -> None:
    series = BisectedSeries(
        baseline="good",
        checkpoints=("a.onnx", "b.onnx", "c.onnx"),
        runs={},
        found=Bisection(words={0: "PASS", 1: "REGRESSED", 2: "REGRESSED"}, length=3),
        folder=Path("reports/bisect-one"),
    )
    found = json.loads(series_json(series))
    assert (found["last_passed"], found["first_flagged"]) == ("a.onnx", "b.onnx")
    assert found["suspects"] == ["b.onnx"]
    assert found["exit_code"] == 1
    assert [each["checkpoint"] for each in found["checkpoints"]] == ["a.onnx", "b.onnx", "c.onnx"]
    assert {each["verdict"] for each in found["checkpoints"]} == {None}, "no run is known"


def test_a_watch_prints_a_line_for_each_checkpoint_as_soon_as_it_is_judged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    two, seven = (
        WatchedCheckpoint(name=f"model_{step}.pt", step=step, sha256="0", run="", verdict="PASS")
        for step in (2, 7)
    )
    lines: list[str] = []

    def watched(folder: Path, **given: Any) -> WatchedTraining:
        for each in (seven, two):
            given["progress"](each)
            lines.append(capsys.readouterr().out)
        return WatchedTraining(
            folder=folder,
            checkpoints=(two, seven),
            best=seven,
            interrupted=False,
            page=folder / "index.html",
            table=folder / "watch.parquet",
        )

    assert "watch" in dict(forms()), "its options are made of the function that is replaced"
    monkeypatch.setattr("nw_eval.api.watch", watched)
    assert ends("watch", tmp_path, "--suite", "smoke", "--json") == 0
    assert capsys.readouterr().out == ""
    assert [line.count("\n") for line in lines] == [1, 1]
    assert [json.loads(line)["step"] for line in lines] == [7, 2]


def test_a_verdict_is_an_object_with_its_exit_code_and_no_github_output(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    words = [
        "smoke",
        "--policy",
        "stand",
        "-n",
        "1",
        "--scenes",
        "hurdles/three_low",
        "--record",
        "none",
    ]
    found = printed(capsys, "run", *words, "--out", "run")
    assert isinstance(found, dict)
    assert (found["verdict"], found["exit_code"], found["trials"]) == ("RAN", 0, 1)
    assert found["scenes"] == {"hurdles/three_low": {"success": 0.0, "trials": 1, "completed": 0}}
    again = printed(capsys, "gate", "run")
    assert isinstance(again, dict)
    assert {**again, "report": None, "html": None} == {**found, "report": None, "html": None}
    shutil.rmtree("run")
    assert ends("gate", "run", "--json", "--github") == 2
    assert "--github and --json exclude each other" in capsys.readouterr().err
