"""`--json`: one JSON document on standard output, and nothing else."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from command_line import ends

from nw_eval.cli.verbs import forms
from nw_eval.cli.verbs.help import options_of

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
CHECKS = ("policies check", "robots check", "scenes check", "baseline check", "baseline verify")


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
    assert has >= {*lists, *JUDGES, *CHECKS, "baseline diff", "splat info", "plan", "scores"}


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
