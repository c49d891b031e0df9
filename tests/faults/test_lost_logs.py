"""A log that cannot be written costs the log; a journal that cannot be written ends the run."""

import resource
import shutil
from contextlib import contextmanager

import pytest

from nw_base.errors import StoreError
from nw_base.files.cache import private_dir
from nw_eval import api
from nw_eval.api import reports
from nw_gate.results.journal import read_journal
from nw_gate.results.row import MEASURED, rows_digest, to_dict

SUITE = """\
nw-eval: 1
name: tiny
robot: go1
policy: stand
trials: 1
seed: 7
episode: {duration: 0.2}
scenes: [flat/carpet_room]
record: none
"""


@contextmanager
def file_size_limit(size):
    """Let no process started in the block write a file longer than `size` bytes.

    It fails with EFBIG where a full disk fails with ENOSPC; both are an OSError of `write`.
    """
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.nightly
def test_a_log_that_does_not_fit_the_disk_costs_the_log_and_not_the_trial(tiny_run):
    run = tiny_run("fine", name="full", trials=2)
    with file_size_limit(8_000):
        outcome = run.go(workers=1)
    assert [row.status for row in outcome.rows] == ["ok", "ok"]
    assert {(row.mcap_path, row.mcap_bytes) for row in outcome.rows} == {("", 0)}
    lost = [text for text in run.ears.messages if "log is lost" in text]
    assert len(lost) == 2
    assert "File too large" in lost[0]
    assert "--out" in lost[0]
    assert not list(run.folder.path.glob("mcap/**/*.mcap*")), "a torn log only fills the disk"
    with_logs = tiny_run("fine", name="roomy", trials=2).go(workers=1)
    assert rows_digest(outcome.rows) == rows_digest(with_logs.rows)


def test_a_folder_that_cannot_be_made_costs_the_logs_and_not_the_trials(tiny_run):
    run = tiny_run("fine", trials=2)
    run.folder.path.mkdir()
    (run.folder.path / "mcap").write_text("in the way")
    outcome = run.go(workers=1)
    assert [row.status for row in outcome.rows] == ["ok", "ok"]
    assert len([text for text in run.ears.messages if "log is lost" in text]) == 2


def test_lost_logs_are_in_report_and_verification_and_are_made_when_the_run_goes_on(tmp_path):
    suite, folder = tmp_path / "suite.yaml", tmp_path / "run"
    suite.write_text(SUITE.replace("trials: 1", "trials: 2"))
    folder.mkdir()
    (folder / "mcap").write_text("in the way")
    lost = api.run(suite, out=folder, workers=1)
    told = "2 logs lost, which could not be written (first that of flat-carpet_room-000)"
    assert any(reason.startswith(told) for reason in lost.verdict.reasons)
    for page in (lost.page, lost.html):
        assert told in page.read_text()
    assert [told in each for each in api.verify(folder, offline=True).files.remarks] == [True]
    (folder / "mcap").unlink()
    made = api.run(None, resume=folder, workers=1)
    assert rows_digest(made.rows) == rows_digest(lost.rows)
    assert len(list(folder.glob("mcap/**/*.mcap"))) == 2
    assert not any("lost" in reason for reason in made.verdict.reasons)
    checked = api.verify(folder, offline=True)
    assert (checked.files.findings, checked.files.remarks, checked.files.logs) == ((), (), 2)


def test_a_splat_that_only_the_log_wants_costs_the_log_and_not_the_trial(
    tiny_run, tmp_path, monkeypatch
):
    (tmp_path / "cache").write_text("in the way of the folder")
    monkeypatch.setenv("NW_EVAL_KERNELS", str(private_dir("kernels")))  # They are none of this.
    monkeypatch.setenv("NW_EVAL_CACHE", str(tmp_path / "cache"))
    run = tiny_run("fine", trials=2, record="failures")
    outcome = run.go(workers=1)
    assert [row.status for row in outcome.rows] == ["ok", "ok"]
    lost = [text for text in run.ears.messages if "log is lost" in text]
    assert len(lost) == 2
    assert "camera failed" in lost[0]


def test_a_full_disk_under_the_journal_ends_the_run_and_keeps_what_is_finished(tiny_run):
    run = tiny_run("fine", name="full", trials=4)
    with file_size_limit(3_000), pytest.raises(StoreError, match="finished trials are kept"):
        run.go(workers=1)
    kept = read_journal(run.folder.journal).rows
    assert 0 < len(kept) < 4
    outcome = run.go(resume=True)
    assert len(outcome.rows) == 4
    whole = tiny_run("fine", name="whole", trials=4).go(workers=1)
    assert rows_digest(outcome.rows) == rows_digest(whole.rows)


def test_a_run_folder_that_is_removed_in_mid_run_ends_the_run_and_is_said(tiny_run):
    run = tiny_run("fine", name="gone", trials=3)

    def remove(_):
        while run.folder.path.exists():  # The worker writes the next trial's log there meanwhile.
            shutil.rmtree(run.folder.path, ignore_errors=True)

    run.ears.trial = remove
    with pytest.raises(StoreError, match="gone was removed or replaced while the run went on"):
        run.go(workers=1)


def test_a_run_folder_that_is_replaced_in_mid_run_is_not_taken_for_the_run(tiny_run):
    run = tiny_run("fine", name="swapped", trials=3)

    def swap(_):
        run.folder.path.rename(run.folder.path.with_name("kept"))
        shutil.copytree(run.folder.path.with_name("kept"), run.folder.path)

    run.ears.trial = swap
    with pytest.raises(StoreError, match="was removed or replaced"):
        run.go(workers=1)
    kept = read_journal(run.folder.path.with_name("kept") / "journal.jsonl").rows
    assert len(kept) == 1


def test_a_folder_that_is_removed_while_the_report_is_written_has_no_verdict(tmp_path, monkeypatch):
    suite = tmp_path / "suite.yaml"
    suite.write_text(SUITE)
    written = reports.report_here

    def remove_and_report(path, **settings):
        told = written(path, **settings)
        shutil.rmtree(path)
        path.mkdir()
        (path / "report.md").write_text("PASS")
        return told

    monkeypatch.setattr("nw_eval.api.runs.report_here", remove_and_report)
    with pytest.raises(StoreError, match="run was removed or replaced"):
        api.run(suite, out=tmp_path / "run", workers=1)


def test_a_folder_that_is_removed_before_the_report_is_a_fault_and_no_misuse(tmp_path, monkeypatch):
    suite = tmp_path / "suite.yaml"
    suite.write_text(SUITE)
    written = reports.report_here

    def report_on_nothing(path, **settings):
        shutil.rmtree(path)
        return written(path, **settings)

    monkeypatch.setattr("nw_eval.api.runs.report_here", report_on_nothing)
    with pytest.raises(StoreError, match="run was removed or replaced"):
        api.run(suite, out=tmp_path / "run", workers=1)


def test_one_and_two_workers_give_the_same_rows_but_for_wall_times(tiny_run):
    one = tiny_run("fine", name="one", trials=10).go(workers=1)
    two = tiny_run("fine", name="two", trials=10).go(workers=2)
    unmeasured = [
        [
            {name: value for name, value in to_dict(row).items() if name not in MEASURED}
            for row in sorted(outcome.rows, key=lambda row: row.trial_id)
        ]
        for outcome in (one, two)
    ]
    assert unmeasured[0] == unmeasured[1]
    assert len({row.state_digest for row in one.rows}) == 10, "ten seeds, ten trajectories"
