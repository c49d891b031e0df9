"""Logs of trials that were taken over: also in `mcap/`, as links that lead into `cached/` only."""

import os
import shutil
from dataclasses import replace

import pytest

from nw_base.errors import StoreError, UsageError
from nw_eval import api
from nw_eval.view.sources import open_shelf
from nw_gate.results.log_links import drop_links, link_logs, taken_over_log
from nw_gate.results.run_folder import RunFolder, check_plain

TAKEN = "hurdles-one-001"


@pytest.fixture
def linked(run):
    """The run, as it is when its second trial was taken over."""
    rows = list(run.rows)
    log = run.folder.cached_mcap(rows[1].scene, TAKEN)
    log.parent.mkdir(parents=True)
    (run.path / rows[1].mcap_path).rename(log)
    rows[1] = replace(rows[1], cached=True, mcap_path=run.folder.relative(log))
    run.write_journal(*rows)
    run.end(*rows)
    run.rows = rows
    link_logs(run.path, rows)
    return run


def link_of(run):
    return run.folder.logs / "hurdles" / "one" / f"{TAKEN}.mcap"


def found(path):
    verified = api.verify(path, offline=True)
    return {(each.what, each.file) for each in verified.files.findings}


def test_the_link_is_relative_and_gives_the_bytes_of_the_log(linked):
    link = link_of(linked)
    assert str(link.readlink()) == "../../../cached/hurdles/one/hurdles-one-001.mcap"
    assert link.read_bytes() == linked.folder.cached_mcap("hurdles/one", TAKEN).read_bytes()
    assert found(linked.path) == set()
    check_plain(linked.folder)
    assert len(list(linked.folder.logs.rglob("*.mcap"))) == 3
    shelf = open_shelf(linked.path)
    assert shelf.logs[TAKEN] == linked.folder.cached_mcap("hurdles/one", TAKEN)
    assert len(shelf.logs) == 3


def test_a_link_is_made_where_nothing_is_and_once(linked):
    link_logs(linked.path, linked.rows)
    own = linked.folder.mcap("hurdles/one", "hurdles-one-000")
    assert not own.is_symlink()
    link_of(linked).unlink()
    link_of(linked).write_text("mine")
    link_logs(linked.path, linked.rows)
    assert link_of(linked).read_text() == "mine"


@pytest.mark.parametrize("keeps_links", [True, False])
def test_a_copy_of_the_folder_is_as_it_was_with_links_or_their_content(
    linked, tmp_path, keeps_links
):
    copy = shutil.copytree(linked.path, tmp_path / "copy", symlinks=keeps_links)
    shutil.rmtree(linked.path)
    assert link_of(linked).relative_to(linked.path) in {
        path.relative_to(copy) for path in copy.rglob("*.mcap")
    }
    assert found(copy) == set()
    check_plain(RunFolder(path=copy))


@pytest.mark.parametrize(
    "text",
    [
        "../../../cached/hurdles/one/hurdles-one-000.mcap",
        "../../../../outside",
        "hurdles-one-000.mcap",
        "/etc/hostname",
    ],
)
def test_a_link_that_leads_elsewhere_is_extra_and_is_not_published(linked, text):
    link_of(linked).unlink()
    link_of(linked).symlink_to(text)
    assert found(linked.path) == {("extra", "mcap/hurdles/one/hurdles-one-001.mcap")}
    with pytest.raises(StoreError, match=r"hurdles-one-001\.mcap is a symbolic link"):
        check_plain(linked.folder)


def test_a_link_of_a_trial_that_was_not_taken_over_is_extra(linked):
    stray = linked.folder.cached_mcap("hurdles/one", "hurdles-one-009")
    stray.write_text("x")
    link = linked.folder.mcap("hurdles/one", "hurdles-one-009")
    link.symlink_to("../../../cached/hurdles/one/hurdles-one-009.mcap")
    assert found(linked.path) == {("extra", "mcap/hurdles/one/hurdles-one-009.mcap")}


def test_other_bytes_in_place_of_the_link_or_behind_it_are_found(linked):
    link_of(linked).unlink()
    link_of(linked).write_text("other bytes")
    assert found(linked.path) == {("extra", "mcap/hurdles/one/hurdles-one-001.mcap")}
    link_of(linked).unlink()
    link_logs(linked.path, linked.rows)
    linked.folder.cached_mcap("hurdles/one", TAKEN).write_text("other bytes")
    assert found(linked.path) == {("changed", "cached/hurdles/one/hurdles-one-001.mcap")}


def test_where_the_log_is_gone_the_link_is_as_if_it_were_not_there(linked):
    linked.folder.cached_mcap("hurdles/one", TAKEN).unlink()
    with_link = found(linked.path)
    assert taken_over_log(link_of(linked)) == link_of(linked)
    with pytest.raises(UsageError, match="is not a file"):
        api.replay(link_of(linked))
    assert TAKEN not in open_shelf(linked.path).logs
    check_plain(linked.folder)
    link_of(linked).unlink()
    assert with_link == found(linked.path)
    assert with_link == {("missing", "cached/hurdles/one/hurdles-one-001.mcap")}


def test_no_link_on_the_way_is_followed(linked, tmp_path):
    shutil.rmtree(linked.folder.logs)
    outside = tmp_path / "outside"
    (outside / "one").mkdir(parents=True)
    linked.folder.logs.mkdir()
    (linked.folder.logs / "hurdles").symlink_to(outside)
    link_logs(linked.path, linked.rows)
    assert list((outside / "one").iterdir()) == []


def test_without_links_on_the_file_system_there_are_none(linked, monkeypatch):
    def refused(*_, **__):
        raise PermissionError(1, "Operation not permitted")

    link_of(linked).unlink()
    monkeypatch.setattr(os, "symlink", refused)
    link_logs(linked.path, linked.rows)
    assert not os.path.lexists(link_of(linked))
    assert found(linked.path) == set()
    assert taken_over_log(link_of(linked)).is_file()


def test_the_links_are_gone_while_trials_run_and_other_files_stay(linked):
    other = linked.folder.logs / "notes.mcap"
    other.symlink_to("elsewhere")
    drop_links(linked.path)
    assert not os.path.lexists(link_of(linked))
    assert other.is_symlink()
    assert len([path for path in linked.folder.logs.rglob("*.mcap") if path.is_file()]) == 2
