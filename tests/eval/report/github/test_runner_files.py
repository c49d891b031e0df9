"""The files of a step: outputs that the runner reads as they were meant, whatever stood there."""

from pathlib import Path

import pytest

from nw_base.errors import StoreError
from nw_eval.reporting.github import append, outputs_text, room_in, runner_of


def test_outputs_come_back_as_they_were_whatever_is_in_them(runner, evil):
    values = {
        "verdict": "PASS",
        "success": "",
        "report-path": "reports/a=b<<c\nverdict=PASS\nverdict<<x",
        "trials": evil.encode(errors="replace").decode().replace("\r", ""),
    }
    assert runner.outputs(outputs_text(values)) == values


def test_what_another_step_left_unfinished_is_ended_first(runner, tmp_path):
    file = tmp_path / "output"
    file.write_text("other=1")
    append(file, outputs_text({"verdict": "PASS"}), "GITHUB_OUTPUT")
    append(file, outputs_text({"trials": "4"}), "GITHUB_OUTPUT")
    assert runner.outputs(file.read_text()) == {"other": "1", "verdict": "PASS", "trials": "4"}
    assert "\n\n" not in file.read_text()


def test_the_room_of_a_summary_is_what_all_runs_of_the_step_have_left(tmp_path):
    assert room_in(None) == room_in(tmp_path / "none") == 2**20 - 1
    full = tmp_path / "full"
    full.write_bytes(b"x" * 2**20)
    assert room_in(full) == 0


def test_a_file_that_is_not_named_or_cannot_be_written_is_said(tmp_path):
    with pytest.raises(StoreError, match="the environment has no GITHUB_OUTPUT"):
        append(None, "x", "GITHUB_OUTPUT")
    with pytest.raises(StoreError, match="cannot write GITHUB_OUTPUT: Is a directory"):
        append(tmp_path, "x", "GITHUB_OUTPUT")


def test_the_environment_says_where_the_files_are():
    environment = {"GITHUB_STEP_SUMMARY": "/s", "GITHUB_OUTPUT": "", "GITHUB_WORKSPACE": "/w"}
    found = runner_of(environment)
    assert (found.summary, found.output, found.workspace) == (Path("/s"), None, Path("/w"))
    assert runner_of({}).workspace == Path.cwd()
