"""What somebody may do to a run's folder, and what `verify --offline` says of it."""

import json
from dataclasses import replace

import pytest

from nw_base.errors import StoreError, UsageError
from nw_eval import api
from nw_gate.results import evidence_check
from nw_gate.results.parquet import read_rows, write_rows

SUCCESS = {"success": 1.0, "completed": True, "waypoints_reached": 4, "outcome": "completed"}


def look(run, **options):
    """What was found, as (what, file, trial), and all that was said about it."""
    verified = api.verify(run.path, offline=True, **options)
    assert verified.exit_code == (4 if verified.files.findings else 0)
    assert verified.repeats is None
    found = verified.files.findings
    words = [*(each.about for each in found), *verified.files.remarks]
    return {(each.what, each.file, each.trial) for each in found}, " ".join(words)


def findings(run, **options):
    return look(run, **options)[0]


def rewrite_parquet(run, rows):
    _, metadata = read_rows(run.folder.trials)
    kept = {key: value for key, value in metadata.items() if key != "rows_digest"}
    write_rows(run.folder.trials, rows, kept)


def test_a_run_is_as_it_ended_also_once_its_table_was_written_again(run):
    run.folder.trials.unlink()
    run.write_info(trials_sha256="of other bytes, as another Arrow writes them")
    judged = api.judge(run.path, baseline="none")
    assert "written again" in judged.verdict.reasons[-1]
    verified = api.verify(run.path, offline=True)
    assert verified.exit_code == 0
    assert verified.files.remarks == ()
    assert (verified.files.rows, verified.files.logs) == (3, 3)
    assert verified.files.root == run.info.merkle_root


def test_verifying_writes_nothing(run):
    run.folder.trials.unlink()
    before = {path: path.stat().st_mtime_ns for path in run.path.rglob("*")}
    findings(run)
    assert {path: path.stat().st_mtime_ns for path in run.path.rglob("*")} == before


def test_a_row_that_was_changed_in_the_journal_is_named_with_its_columns(run):
    run.write_journal(*run.changed(1, **SUCCESS))
    found, about = look(run)
    assert found == {("changed", "journal.jsonl", "hurdles-one-001")}
    assert "outcome is completed, was fell" in about


def test_a_column_that_no_rows_digest_has_cannot_be_changed_either(run):
    before = [row.digest for row in run.rows]
    rows = run.changed(0, tier="informational")
    assert [row.digest for row in rows] == before
    run.write_journal(*rows)
    assert findings(run) == {("changed", "journal.jsonl", "hurdles-one-000")}


def test_a_row_that_was_changed_in_trials_parquet_is_named(run):
    rewrite_parquet(run, run.changed(2, **SUCCESS))
    assert findings(run) == {("changed", "trials.parquet", "hurdles-one-002")}


def test_rows_that_are_the_same_in_both_files_are_held_once(run):
    rewrite_parquet(run, run.changed(2, **SUCCESS))
    names = [row.trial_id for row in run.rows]
    journal, table = evidence_check._copies_of(run.folder, names, ended=True)
    assert [journal.rows[name] is table.rows[name] for name in names] == [True, True, False]


def test_two_rows_of_one_trial_in_trials_parquet_are_said(run):
    rewrite_parquet(run, [*run.rows, run.rows[1]])
    found, about = look(run)
    assert found == {("unreadable", "trials.parquet", "")}
    assert "two rows of one trial" in about


def test_a_row_that_was_changed_in_both_is_named_by_the_digests_of_the_end(run):
    rows = run.changed(2, **SUCCESS)
    run.write_journal(*rows)
    rewrite_parquet(run, rows)
    both = {("changed", name, "hurdles-one-002") for name in ("journal.jsonl", "trials.parquet")}
    assert findings(run) == both


def test_rows_that_were_left_out_or_put_in_are_named(run):
    run.write_journal(*run.rows[:2])
    assert findings(run) == {("missing", "journal.jsonl", "hurdles-one-002")}
    run.end(*run.rows[:2])
    run.write_journal(*run.rows)
    assert ("extra", "journal.jsonl", "hurdles-one-002") in findings(run)


def test_an_earlier_attempt_that_was_changed_is_no_row_and_yet_no_journal_of_this_run(run):
    failed = {"status": "error", "outcome": "crashed", "success": None, "end_reason": "error"}
    earlier = replace(run.rows[0], **failed, error_type="crashed", error_text="out of memory")
    run.write_journal(earlier, *run.rows)
    run.end(*run.rows)
    assert findings(run) == set()
    run.write_journal(replace(earlier, error_text="nothing of note"), *run.rows)
    found, about = look(run)
    assert found == {("changed", "journal.jsonl", "")}
    assert "earlier attempts" in about


def test_a_journal_that_was_damaged_is_said_to_be_and_the_rows_are_looked_at_all_the_same(run):
    data = bytearray(run.folder.journal.read_bytes())
    data[len(data) // 2] ^= 4
    run.folder.journal.write_bytes(data)
    run.folder.mcap("hurdles/one", "hurdles-one-001").unlink()
    log = "mcap/hurdles/one/hurdles-one-001.mcap"
    found = {("unreadable", "journal.jsonl", ""), ("missing", log, "hurdles-one-001")}
    assert findings(run) == found


def test_a_log_of_which_one_byte_was_changed_is_named(run):
    log = run.folder.mcap("hurdles/one", "hurdles-one-001")
    data = bytearray(log.read_bytes())
    data[100] ^= 1
    log.write_bytes(data)
    assert findings(run) == {("changed", run.folder.relative(log), "hurdles-one-001")}


def test_logs_that_are_missing_or_too_many_are_named(run):
    log = run.folder.mcap("hurdles/one", "hurdles-one-001")
    log.rename(log.with_name("another.mcap"))
    assert findings(run) == {
        ("missing", run.folder.relative(log), "hurdles-one-001"),
        ("extra", "mcap/hurdles/one/another.mcap", ""),
    }


def test_a_log_that_is_named_outside_of_the_run_is_not_opened(run, tmp_path):
    secret = tmp_path / "secret.mcap"
    secret.write_bytes(b"not of this run")
    rows = run.changed(0, mcap_path="../secret.mcap")
    run.write_journal(*rows)
    run.end(*rows)
    link = run.folder.mcap("hurdles/one", "hurdles-one-001")
    link.unlink()
    link.symlink_to(secret)
    found = findings(run)
    assert ("unreadable", "../secret.mcap", "hurdles-one-000") in found
    assert ("unreadable", run.folder.relative(link), "hurdles-one-001") in found


def test_another_root_in_run_json_is_named_though_rows_and_logs_are_whole(run):
    run.write_info(merkle_root="ab" * 32)
    assert findings(run) == {("changed", "run.json", "")}


def test_the_bar_that_rows_are_judged_by_is_under_the_root(run):
    suite = run.info.suite
    run.write_info(suite={**suite, "gate": {**suite["gate"], "success_rate": 0.1}})
    found, about = look(run)
    assert found == {("changed", "run.json", "")}
    assert "suite" in about


def test_digests_that_are_gone_or_changed_do_not_hide_a_row_in_one_of_its_files(run):
    record = json.loads(run.folder.digests.read_text())
    run.folder.digests.unlink()
    assert findings(run) == {("missing", "digests.json", "")}
    run.folder.digests.write_text(json.dumps(record))
    run.write_journal(*run.changed(1, **SUCCESS))
    row = ("changed", "journal.jsonl", "hurdles-one-001")
    assert findings(run) == {("unreadable", "digests.json", ""), row}


def test_who_writes_everything_anew_is_found_by_a_root_that_is_kept_elsewhere(run):
    kept = run.info.merkle_root
    rows = run.changed(1, **SUCCESS)
    run.write_journal(*rows)
    run.end(*rows)
    assert findings(run) == set(), "a root is no signature"
    assert findings(run, root=kept) == {("changed", "run.json", "")}


def test_a_run_that_has_not_ended_is_no_error(run):
    run.write_info(finished=None, rows_digest="", trials_sha256="", journal_sum="", merkle_root="")
    run.write_journal(*run.rows[:2])
    with run.folder.journal.open("ab") as stream:
        stream.write(b'{"row":{"trial_id":')  # As it is being written.
    found, remarks = look(run)
    assert found == set()
    assert "has not ended" in remarks
    assert "1 planned trial without a row" in remarks
    run.folder.mcap("hurdles/one", "hurdles-one-000").write_bytes(b"another")
    assert len(findings(run)) == 1, "its logs are known all the same"


def test_an_interrupted_run_may_have_a_log_whose_row_did_not_come_to_be(run):
    run.write_journal(*run.rows[:2])
    run.end(*run.rows[:2])
    assert findings(run) == {("extra", "mcap/hurdles/one/hurdles-one-002.mcap", "")}
    run.write_info(interrupted=True)
    assert findings(run) == set()


def test_logs_of_trials_that_a_resumed_run_no_longer_plans_are_not_too_many(run):
    suite = {**run.info.suite, "trials": 2}
    scenes = {
        name: scene.model_copy(update={"trials": 2}) for name, scene in run.info.scenes.items()
    }
    run.write_info(suite=suite, scenes=scenes)
    run.end(*run.rows[:2])
    assert findings(run) == set()


def test_a_run_of_an_older_version_is_said_to_be_one_and_its_rows_are_compared_as_a_whole(run):
    rows = [replace(row, mcap_sha256="") for row in run.rows]
    run.write_journal(*rows)
    run.end(*rows)
    run.write_info(merkle_root="")
    run.folder.digests.unlink()
    found, remarks = look(run)
    assert found == set()
    assert "an older nw-eval made the run" in remarks
    assert "3 logs not compared" in remarks
    run.write_journal(*run.changed(0, **SUCCESS))
    assert findings(run) == {("changed", "journal.jsonl", "")}


def test_what_is_no_run_no_sample_and_no_root_is_refused(run, tmp_path):
    with pytest.raises(UsageError, match="not the folder of a run"):
        api.verify(tmp_path)
    with pytest.raises(UsageError, match="neither a share nor a number of trials"):
        api.verify(run.path, trials="0%")
    with pytest.raises(UsageError, match="64 hex digits"):
        api.verify(run.path, root="abc")
    run.write_info(suite_digest="ab" * 32)
    with pytest.raises(StoreError, match=r"run\.json of run is damaged"):
        api.verify(run.path, offline=True)
