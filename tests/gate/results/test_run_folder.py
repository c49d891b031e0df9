from __future__ import annotations

from datetime import datetime, timedelta, timezone

import pytest

from nw_base.errors import StoreError, UsageError
from nw_gate.results.provenance import (
    code_info,
    library_versions,
    machine_info,
    read_run_info,
    write_run_info,
)
from nw_gate.results.run_folder import create_run_folder, open_run_folder

NOON = datetime(2026, 11, 21, 12, 0, 5, tzinfo=timezone(timedelta(hours=1)))


def test_a_folder_is_named_by_suite_policy_utc_time_and_digest(tmp_path):
    folder = create_run_folder(
        tmp_path / "reports", suite="hurdles", policy="go1-parkour", digest="0123456789", now=NOON
    )
    assert folder.id == "hurdles-go1-parkour-20261121T110005Z-01234567"
    assert folder.path.is_dir()
    assert folder.relative(folder.mcap("hurdles/one", "hurdles-one-003")) == (
        "mcap/hurdles/one/hurdles-one-003.mcap"
    )


def test_two_runs_of_one_second_get_folders_of_their_own(tmp_path):
    paths = {
        create_run_folder(tmp_path, suite="s", policy="p", digest="0" * 8, now=NOON).path
        for _ in range(3)
    }
    assert len(paths) == 3


def test_a_policy_given_as_a_path_makes_a_plain_name(tmp_path):
    folder = create_run_folder(
        tmp_path, suite="s", policy="../my policies/é/", digest="0" * 8, now=NOON
    )
    assert folder.path.parent == tmp_path
    assert folder.id == "s-my-policies-20261121T110005Z-00000000"


def test_a_place_that_cannot_be_written_is_told(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(StoreError, match=r"choose .* with --out"):
        create_run_folder(tmp_path / "file", suite="s", policy="p", digest="0" * 8)
    with pytest.raises(StoreError, match=r"choose .* with --out"):
        create_run_folder(tmp_path / "file" / "deeper", suite="s", policy="p", digest="0" * 8)


def test_a_run_opens_by_its_folder_or_a_file_in_it_and_nothing_else_does(tmp_path, run_json):
    folder = create_run_folder(tmp_path, suite="s", policy="p", digest="0" * 8)
    with pytest.raises(UsageError, match="is not the folder of a run"):
        open_run_folder(folder.path)
    write_run_info(folder.run_json, run_json)
    assert open_run_folder(folder.path) == folder
    assert open_run_folder(folder.run_json) == folder
    with pytest.raises(UsageError, match="is not the folder of a run"):
        open_run_folder(tmp_path)


def test_provenance_reads_back_equal_and_says_what_was_planned(tmp_path, run_json):
    write_run_info(tmp_path / "run.json", run_json)
    again = read_run_info(tmp_path / "run.json")
    assert again == run_json
    assert again.planned == {"hurdles/one": 10}


def test_provenance_names_the_code_and_the_libraries_that_ran():
    assert len(code_info().digest) == 64
    assert {"mujoco", "numpy", "torch"} <= set(library_versions())
    assert machine_info().cores >= 1


def test_a_damaged_run_json_is_told_with_the_place(tmp_path, run_json):
    path = tmp_path / "run.json"
    with pytest.raises(StoreError, match="no run at"):
        read_run_info(path)
    path.write_text(run_json.model_dump_json().replace('"trials":10', '"trials":"ten"'))
    with pytest.raises(StoreError, match=r"damaged: scenes\.hurdles/one\.trials"):
        read_run_info(path)
    path.write_text("{")
    with pytest.raises(StoreError, match="damaged"):
        read_run_info(path)
