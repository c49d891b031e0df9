"""`--ledger` keeps the verdicts on runs, and `nw-eval ledger` reckons them up."""

import shutil

import pytest
from command_line import ends

from nw_base.errors import StoreError
from nw_eval import api
from nw_gate.ledger import read_ledger


def test_verdicts_of_runs_and_gates_are_kept_and_reckoned_up(
    regressed_run, tmp_path, monkeypatch, capsys
):
    shutil.copytree(regressed_run, tmp_path / "again")
    monkeypatch.chdir(tmp_path)
    assert ends("run", "--resume", "again", "-j", 1, "--ledger", "all/ledger.jsonl") == 1
    assert ends("gate", "again", "--ledger", "all/ledger.jsonl") == 1
    first, second = read_ledger(tmp_path / "all/ledger.jsonl").entries
    assert (first.candidate, first.word, first.trials) == ("stand", "REGRESSED", 2)
    assert first.test == second.test, "the same trials by the same rules"
    report = api.read_ledger("all/ledger.jsonl")
    assert (report.entries, report.judged_again) == (2, 1)
    capsys.readouterr()
    assert ends("ledger", "all/ledger.jsonl") == 0
    page = capsys.readouterr().out
    assert "2 verdicts (2 REGRESSED)" in page
    assert f"head {report.head}: kept elsewhere" in page
    assert ends("ledger", "all/ledger.jsonl", "--head", report.head) == 0
    assert ends("ledger", "all/ledger.jsonl", "--head", "0" * 16) == 4
    assert "has the sum 0000000000000000: its end was cut off" in capsys.readouterr().err
    assert first.computes == second.computes != ""
    assert len(first.trajectories) == 2
    assert set(first.tiers.values()) == {"supporting"}


def test_a_ledger_that_cannot_be_written_costs_no_verdict(regressed_run, tmp_path, capsys):
    (tmp_path / "ledger.jsonl").mkdir()
    assert ends("gate", regressed_run, "--ledger", tmp_path / "ledger.jsonl") == 4
    shown = capsys.readouterr()
    assert "REGRESSED" in shown.out
    assert "cannot write" in shown.err
    with pytest.raises(StoreError, match="no ledger at"):
        api.read_ledger(tmp_path / "ledger.jsonl")
