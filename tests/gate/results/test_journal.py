from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import pytest

from nw_base.errors import IncomparableError, StoreError
from nw_gate.results.journal import Journal, JournalHeader, has_begun, read_journal
from nw_gate.results.seal import seal

HEADER = JournalHeader(
    suite_digest="aa" * 32,
    policy_digest="bb" * 32,
    scene_digests={"hurdles/one": "cc" * 32},
    engine={"mujoco": "4.0.0"},
)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "run" / "journal.jsonl"


def test_rows_are_on_disk_one_line_each_as_soon_as_they_are_appended(path, make_row):
    with Journal.create(path, HEADER) as journal:
        for index in range(3):
            journal.append(make_row(trial_id=f"t{index}"))
            contents = read_journal(path)
            assert [row.trial_id for row in contents.rows] == [f"t{k}" for k in range(index + 1)]
    assert contents.header == HEADER
    assert contents.dropped is None
    assert len(path.read_bytes().splitlines()) == 4


def test_a_torn_last_line_is_dropped_told_and_cut_off_before_the_next(path, make_row):
    with Journal.create(path, HEADER) as journal:
        journal.append(make_row(trial_id="t0"))
        journal.append(make_row(trial_id="t1"))
    whole = path.read_bytes()
    path.write_bytes(whole[:-30])
    contents = read_journal(path)
    assert [row.trial_id for row in contents.rows] == ["t0"]
    assert contents.dropped is not None
    assert ":3: dropped a line" in contents.dropped
    with Journal.resume(path, HEADER) as journal:
        assert journal.dropped == contents.dropped
        assert [row.trial_id for row in journal.rows] == ["t0"]
        journal.append(make_row(trial_id="t1"))
    assert path.read_bytes() == whole


def test_every_possible_tear_of_the_last_line_is_survived(path, make_row):
    with Journal.create(path, HEADER) as journal:
        journal.append(make_row(trial_id="t0"))
        before = path.stat().st_size
        journal.append(make_row(trial_id="t1"))
    whole = path.read_bytes()
    for cut in range(before, len(whole), 7):
        path.write_bytes(whole[:cut])
        contents = read_journal(path)
        assert [row.trial_id for row in contents.rows] == ["t0"]
        assert contents.good_bytes == before


def test_damage_before_the_last_line_is_an_error_with_its_line(path, make_row):
    with Journal.create(path, HEADER) as journal:
        for index in range(3):
            journal.append(make_row(trial_id=f"t{index}"))
    lines = path.read_bytes().splitlines(keepends=True)
    lines[1] = b"{nonsense}\n"
    path.write_bytes(b"".join(lines))
    with pytest.raises(StoreError, match=r"journal\.jsonl:2: damaged"):
        read_journal(path)


@pytest.mark.parametrize(
    ("order", "line"),
    [
        ([0, 1, 3], 3),  # One is missing,
        ([0, 1, 2, 2, 3], 4),  # one is there twice,
        ([0, 2, 1, 3], 2),  # two are exchanged.
    ],
)
def test_lines_that_were_left_out_repeated_or_exchanged_are_noticed(path, make_row, order, line):
    with Journal.create(path, HEADER) as journal:
        for index in range(3):
            journal.append(make_row(trial_id=f"t{index}"))
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(lines[index] for index in order))
    with pytest.raises(StoreError, match=rf"journal\.jsonl:{line}: damaged .*checksum") as caught:
        read_journal(path)
    # What the error advises works.
    assert f"keep the {line - 1} lines before it" in str(caught.value)
    path.write_bytes(b"".join(path.read_bytes().splitlines(keepends=True)[: line - 1]))
    with Journal.resume(path, HEADER) as journal:
        assert len(journal.rows) == line - 2


def test_a_changed_number_is_noticed_in_the_last_line_too(path, make_row):
    with Journal.create(path, HEADER) as journal:
        journal.append(make_row())
    text = path.read_text()
    assert '"waypoints_reached":3' in text
    path.write_text(text.replace('"waypoints_reached":3', '"waypoints_reached":2'))
    with pytest.raises(StoreError, match=r"journal\.jsonl:2: damaged \(its checksum is"):
        read_journal(path)


@pytest.mark.parametrize("version", [1, 2])
def test_a_journal_of_an_earlier_version_is_told(path, version):
    path.parent.mkdir()
    line = f'{{"journal":{version},"suite_digest":"aa"}}'
    path.write_text(seal(line, "")[0] if version > 1 else f"{line}\n")
    words = rf"journal version {version}, this nw-eval reads 3.*new run"
    with pytest.raises(StoreError, match=words):
        read_journal(path)


@pytest.mark.parametrize("left", [b"", b'{"journal":3,"suite_di', bytes(4096)])
def test_a_start_that_was_cut_off_is_no_journal_and_can_be_started_again(path, make_row, left):
    path.parent.mkdir()
    path.write_bytes(left)
    assert not has_begun(path)
    with Journal.create(path, HEADER) as journal:
        assert has_begun(path)
        journal.append(make_row())
    assert read_journal(path).rows == (make_row(),)


def test_an_empty_or_missing_journal_says_so(path):
    with pytest.raises(StoreError, match="no journal at"):
        read_journal(path)
    path.parent.mkdir()
    path.touch()
    with pytest.raises(StoreError, match="is empty"):
        read_journal(path)
    with pytest.raises(StoreError, match="start the run without --resume"):
        Journal.resume(path.with_name("other.jsonl"), HEADER)


def test_a_run_is_not_started_over_another(path):
    Journal.create(path, HEADER).close()
    with pytest.raises(StoreError, match="exists already; continue with --resume"):
        Journal.create(path, HEADER)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"suite_digest": "ab" * 32}, r"suite \(aaaaaaaa, now abababab\) changed"),
        ({"policy_digest": "ab" * 32}, r"policy \(bbbbbbbb, now abababab\)"),
        (
            {"scene_digests": {"hurdles/one": "ab" * 32}},
            r"scene hurdles/one \(cccccccc, now abababab\)",
        ),
        ({"engine": {"mujoco": "4.1.0"}}, r"mujoco \(4\.0\.0, now 4\.1\.0\)"),
    ],
)
def test_resuming_under_other_digests_is_refused_by_name(path, change, words):
    Journal.create(path, HEADER).close()
    before = path.read_bytes()
    with pytest.raises(IncomparableError, match=words) as caught:
        Journal.resume(path, replace(HEADER, **change))
    assert caught.value.exit_code == 5
    assert path.read_bytes() == before


def test_resuming_with_one_more_scene_is_fine_and_is_written_down(path):
    Journal.create(path, HEADER).close()
    wider = replace(HEADER, scene_digests={"hurdles/two": "dd" * 32})
    Journal.resume(path, wider).close()
    assert read_journal(path).header.scene_digests == {
        "hurdles/one": "cc" * 32,
        "hurdles/two": "dd" * 32,
    }


def test_a_retry_supersedes_an_error_but_never_a_result(path, make_row):
    error = make_row(status="error", outcome="crashed", success=None)
    with Journal.create(path, HEADER) as journal:
        journal.append(error)
        journal.append(make_row(attempt=2, mcap_path="mcap/one.mcap"))
        journal.append(replace(error, attempt=3))
        journal.append(make_row(attempt=4, wall_s=9.0))  # The same result, measured again.
        with pytest.raises(StoreError, match="has two different results"):
            journal.append(make_row(attempt=5, outcome="timeout"))
        assert [row.attempt for row in journal.rows] == [2]
    assert [row.attempt for row in read_journal(path).rows] == [2]


class FullDisk:
    """A file whose disk has room for some bytes more."""

    def __init__(self, handle: object, room: int) -> None:
        self.handle, self.room = handle, room

    def write(self, data: bytes) -> int:
        part = data[: self.room]
        self.room -= len(part)
        if not part:
            raise OSError(28, "No space left on device")
        return self.handle.write(part)

    def __getattr__(self, name: str) -> object:
        return getattr(self.handle, name)


def test_a_full_disk_is_told_and_leaves_the_finished_trials_whole(path, make_row):
    with Journal.create(path, HEADER) as journal:
        journal.append(make_row(trial_id="t0"))
        before = path.read_bytes()
        disk = journal._handle
        journal._handle = FullDisk(disk, room=100)
        with pytest.raises(StoreError, match=r"cannot write .*: No space left.*--out") as caught:
            journal.append(make_row(trial_id="t1"))
        assert caught.value.exit_code == 4
        assert path.read_bytes() == before
        assert [row.trial_id for row in journal.rows] == ["t0"]
        journal._handle = disk  # Somebody made room.
        journal.append(make_row(trial_id="t1"))
    assert [row.trial_id for row in read_journal(path).rows] == ["t0", "t1"]


@pytest.mark.parametrize("room", [100, 1500])  # Half of the first line, or of the second.
def test_of_rows_that_are_there_together_a_full_disk_keeps_all_or_none(path, make_row, room):
    rows = [make_row(trial_id=f"t{k}", seed_index=k) for k in range(3)]
    with Journal.create(path, HEADER) as journal:
        before = path.read_bytes()
        disk = journal._handle
        journal._handle = FullDisk(disk, room=room)
        with pytest.raises(StoreError, match="No space left"):
            journal.extend(rows)
        assert path.read_bytes() == before
        assert journal.rows == ()
        journal._handle = disk
        journal.extend(rows)
    assert read_journal(path).rows == tuple(rows)


def test_rows_that_are_there_together_are_the_lines_that_they_are_alone_with_one_wait(
    path, make_row, monkeypatch
):
    rows = [make_row(trial_id=f"t{k}", seed_index=k, wall_s=k / 7) for k in range(20)]
    alone = path.with_name("alone.jsonl")
    waits = []
    with Journal.create(path, HEADER) as journal, Journal.create(alone, HEADER) as other:
        monkeypatch.setattr(os, "fsync", waits.append)
        journal.extend(rows)
        assert len(waits) == 1
        for row in rows:
            other.append(row)
    assert path.read_bytes() == alone.read_bytes()


def test_rows_that_contradict_each_other_are_not_written_together(path, make_row):
    with Journal.create(path, HEADER) as journal:
        error = make_row(status="error", outcome="crashed", success=None)
        journal.extend([error, make_row(attempt=2)])
        before = path.read_bytes()
        with pytest.raises(StoreError, match="has two different results"):
            journal.extend([make_row(trial_id="t1"), make_row(attempt=3, outcome="timeout")])
        assert path.read_bytes() == before
        assert [row.attempt for row in journal.rows] == [2]


def test_a_killed_process_keeps_whole_lines_of_rows_that_it_was_writing_together(path, make_row):
    rows = [make_row(trial_id=f"t{k}", seed_index=k) for k in range(20)]
    with Journal.create(path, HEADER) as journal:
        journal.append(rows[0])
        acknowledged = path.stat().st_size
        journal.extend(rows[1:])
    whole = path.read_bytes()
    ends = [at + 1 for at, byte in enumerate(whole) if byte == ord("\n")]
    for cut in range(acknowledged, len(whole), 997):
        path.write_bytes(whole[:cut])
        kept = read_journal(path).rows
        assert kept == tuple(rows[: sum(end <= cut for end in ends) - 1])


def test_a_folder_that_cannot_be_made_is_told(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(StoreError, match=r"cannot write .*journal\.jsonl.*--out"):
        Journal.create(tmp_path / "file" / "journal.jsonl", HEADER)


def test_appending_after_the_end_is_refused(path, make_row):
    journal = Journal.create(path, HEADER)
    journal.close()
    journal.close()
    with pytest.raises(StoreError, match="is closed"):
        journal.append(make_row())


WRITER = """
import sys
from pathlib import Path
from nw_gate.results.journal import Journal, JournalHeader, read_journal
path = Path(sys.argv[1])
header = JournalHeader(suite_digest="aa", policy_digest="bb", scene_digests={})
row = read_journal(path).rows[0]
import dataclasses
with Journal.resume(path, header) as journal:
    for index in range(1, 1_000_000):
        journal.append(dataclasses.replace(row, trial_id=f"t{index}"))
        print(index, flush=True)
"""


def test_a_killed_process_loses_nothing_that_it_had_appended(path, make_row):
    header = JournalHeader(suite_digest="aa", policy_digest="bb", scene_digests={})
    with Journal.create(path, header) as journal:
        journal.append(make_row(trial_id="t0"))
    with subprocess.Popen(
        [sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, text=True
    ) as writer:
        assert writer.stdout is not None
        told = [writer.stdout.readline() for _ in range(20)]
        with pytest.raises(StoreError, match="held by another nw-eval process"):
            Journal.resume(path, header)
        os.kill(writer.pid, signal.SIGKILL)
        told += writer.stdout.readlines()
    last = int(told[-1])
    deadline = time.monotonic() + 60.0
    while True:
        try:
            journal = Journal.resume(path, header)
            break
        except StoreError:  # The kernel may take a moment to release the lock.
            assert time.monotonic() < deadline
            time.sleep(0.05)
    with journal:
        ids = [row.trial_id for row in journal.rows]
    assert ids[: last + 1] == [f"t{k}" for k in range(last + 1)]
    assert len(ids) <= last + 2
