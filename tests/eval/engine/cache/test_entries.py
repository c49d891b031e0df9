"""What is not exactly what was written is no entry; nothing that lies there does harm."""

import json
import os
import time
from dataclasses import replace
from hashlib import sha256

import pytest
from cache_parts import DONE, conditions_of, finish, jobs_of, row_of
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from nw_base.errors import UsageError
from nw_eval.engine.cache import NO_ENTRY, TrialStore, limit_bytes, read_entry, told_of_cache
from nw_gate.results.seal import seal

HERE = conditions_of()


@pytest.fixture
def job(folder):
    return jobs_of(folder)[0]


@pytest.fixture
def kept(store, folder, job):
    """Return the folder of an entry."""
    store.put(HERE, HERE.key(job), row_of(job, folder), job.mcap)
    return store.folder / HERE.digest / HERE.key(job)


@pytest.fixture
def usable(store, job, tmp_path):
    """Return whether a run could take the entry over, row and log."""

    def look():
        entry = store.find(HERE, HERE.key(job))
        if entry is None:
            return False
        try:
            entry.link_log(tmp_path / "later" / "log.mcap")
        except NO_ENTRY:
            return False
        return True

    return look


def test_an_entry_is_the_row_and_a_link_to_the_log(store, kept, job, folder, tmp_path):
    entry = store.find(HERE, HERE.key(job))
    assert entry.row == row_of(job, folder)
    entry.link_log(tmp_path / "later" / "log.mcap")
    assert (kept / "log.mcap").samefile(tmp_path / "later" / "log.mcap")
    assert [path.name for path in (tmp_path / "later").iterdir()] == ["log.mcap"]


def test_a_log_that_is_linked_twice_stays_one_file_of_one_name(kept, tmp_path):
    entry = read_entry(kept)
    for _ in range(2):
        entry.link_log(tmp_path / "later" / "log.mcap")
    assert [path.name for path in (tmp_path / "later").iterdir()] == ["log.mcap"]


def test_who_writes_to_the_log_of_the_run_that_was_kept_changes_no_entry(kept, job, usable):
    with job.mcap.open("r+b") as log:
        log.write(b"forged")
    assert not (kept / "log.mcap").read_bytes().startswith(b"forged")
    assert usable()


def test_a_log_that_was_damaged_before_it_was_kept_makes_no_entry(store, folder, job, usable):
    store.put(HERE, HERE.key(job), row_of(job, folder), job.mcap)
    assert usable()
    row = replace(row_of(job, folder), mcap_sha256=sha256(job.mcap.read_bytes()).hexdigest())
    job.mcap.write_bytes(b"other bytes")
    store.put(HERE, HERE.key(job), row, job.mcap)
    assert not usable()


def test_a_trial_that_runs_in_the_place_of_a_link_leaves_the_entry_as_it_is(kept, job, usable):
    read_entry(kept).link_log(job.mcap)
    finish(job, DONE)
    assert usable()


def test_a_log_on_another_disk_is_copied(store, job, folder, tmp_path, usable, monkeypatch):
    def refuse(*_, **__):
        raise OSError(18, "Invalid cross-device link")

    monkeypatch.setattr(os, "link", refuse)
    store.put(HERE, HERE.key(job), row_of(job, folder), job.mcap)
    assert usable()
    assert (tmp_path / "later" / "log.mcap").read_bytes() == job.mcap.read_bytes()


def test_a_row_that_is_cut_anywhere_is_no_entry(kept, usable):
    whole = (kept / "row.json").read_bytes()
    for length in range(len(whole) - 1):  # The last byte ends a line that is whole without it.
        (kept / "row.json").write_bytes(whole[:length])
        assert not usable(), length


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_a_byte_that_flips_anywhere_is_seen(kept, usable, data):
    name = data.draw(st.sampled_from(["row.json", "log.mcap"]))
    whole = (kept / name).read_bytes()
    place = data.draw(st.integers(0, len(whole) - 2))
    flipped = whole[place] ^ 1 << data.draw(st.integers(0, 7))
    (kept / name).write_bytes(whole[:place] + bytes([flipped]) + whole[place + 1 :])
    try:
        assert not usable()
    finally:
        (kept / name).write_bytes(whole)


def resealed(kept, **changes):
    """Write row.json with other values and a valid seal."""
    saved = json.loads((kept / "row.json").read_bytes())
    saved = {name: value for name, value in (saved | changes).items() if name != "sum"}
    (kept / "row.json").write_text(seal(json.dumps(saved))[0])


def replaced_by_a_folder(path):
    path.unlink()
    path.mkdir()


def replaced_by_a_link(path):
    moved = path.rename(path.parents[3] / "elsewhere")
    path.symlink_to(moved)


def replaced_by_a_pipe(path):
    path.unlink()
    os.mkfifo(path)


DAMAGE = {
    "another trial's": lambda kept: resealed(kept, key="0" * 64),
    "another version's": lambda kept: resealed(kept, entry=99),
    "of no row": lambda kept: resealed(kept, row={"trial_id": 1}),
    "of a row of no sense": lambda kept: resealed(kept, row=[]),
    "of a log of no sense": lambda kept: resealed(kept, log="none"),
    "of another log": lambda kept: resealed(kept, log={"bytes": 3, "sha256": "0"}),
    "deep": lambda kept: (kept / "row.json").write_text(seal("[" * 10**5 + "]" * 10**5)[0]),
    "huge": lambda kept: (kept / "row.json").write_bytes(b" " * 2**21),
    "empty": lambda kept: (kept / "row.json").write_bytes(b""),
    "without a row": lambda kept: (kept / "row.json").unlink(),
    "without a log": lambda kept: (kept / "log.mcap").unlink(),
    "a row that is a link": lambda kept: replaced_by_a_link(kept / "row.json"),
    "a log that is a link": lambda kept: replaced_by_a_link(kept / "log.mcap"),
    "a row that is a folder": lambda kept: replaced_by_a_folder(kept / "row.json"),
    "a log that is a folder": lambda kept: replaced_by_a_folder(kept / "log.mcap"),
    "a row that is a pipe": lambda kept: replaced_by_a_pipe(kept / "row.json"),
    "a log that is a pipe": lambda kept: replaced_by_a_pipe(kept / "log.mcap"),
    "a link": lambda kept: kept.symlink_to(kept.rename(kept.parents[2] / "elsewhere")),
    "a file": lambda kept: kept.rename(kept.parents[2] / "moved") and kept.write_text("foreign"),
}


@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE)
def test_what_is_none_is_a_miss_and_the_next_result_takes_its_place(
    store, job, folder, kept, usable, damage
):
    assert usable()
    damage(kept)
    assert not usable()
    store.put(HERE, HERE.key(job), row_of(job, folder), job.mcap)
    assert usable()
    assert [path.name for path in kept.parent.iterdir()] == [kept.name]


def test_a_log_that_is_a_link_is_not_kept(store, job, folder, tmp_path):
    row = row_of(job, folder)
    (tmp_path / "secret").write_text("of somebody else")
    job.mcap.unlink()
    job.mcap.symlink_to(tmp_path / "secret")
    with pytest.raises(NO_ENTRY):
        store.put(HERE, HERE.key(job), row, job.mcap)
    assert list((store.folder / HERE.digest).iterdir()) == []


def test_a_row_for_another_key_is_not_read_under_it(kept):
    other = kept.rename(kept.with_name("f" * 64))
    with pytest.raises(ValueError, match="another trial"):
        read_entry(other)


def test_two_processes_that_write_at_once_leave_one_whole_entry(store, job, folder, usable):
    row = row_of(job, folder)
    other = replace(row, wall_s=3.0)
    child = os.fork()
    if child == 0:
        try:
            for _ in range(200):
                store.put(HERE, HERE.key(job), other, job.mcap)
        finally:
            os._exit(0)
    found = set()
    while os.waitpid(child, os.WNOHANG) == (0, 0):
        store.put(HERE, HERE.key(job), row, job.mcap)
        if entry := store.find(HERE, HERE.key(job)):
            found.add(entry.row.wall_s)
    assert found <= {2.0, 3.0}
    assert usable()
    assert len(list((store.folder / HERE.digest).iterdir())) == 1


def test_what_was_not_used_for_longest_goes_first(store, folder):
    jobs = jobs_of(folder, trials=10)
    now = time.time()
    for job in jobs:
        store.put(HERE, HERE.key(job), row_of(job, folder), job.mcap)
        path = store.folder / HERE.digest / HERE.key(job)
        os.utime(path, (now, now - 1000.0 + job.trial.index))
    store.find(HERE, HERE.key(jobs[0])).touch()
    each = max(kept.bytes for kept in store)
    assert store.prune(20 * each) == []
    removed = store.prune(5 * each)
    assert len(removed) >= 5
    left = [job.trial.index for job in jobs if store.find(HERE, HERE.key(job)) is not None]
    assert left == [0, *range(10 - len(left) + 1, 10)]
    assert sum(kept.bytes for kept in store) <= 0.9 * 5 * each


@pytest.mark.usefixtures("kept")
def test_pruning_to_nothing_leaves_an_empty_folder(store):
    (store.folder / "foreign").write_text("what somebody put there")
    (store.folder / "link").symlink_to(store.folder.parent)
    assert len(store.prune(0)) == 3
    assert list(store.folder.iterdir()) == []
    assert store.folder.parent.is_dir()


def test_what_is_just_being_written_is_left_alone_and_what_was_given_up_is_not(store, kept):
    new, old = kept.with_name(".new"), kept.with_name(".old")
    for path in (new, old):
        path.mkdir()
    os.utime(old, (0.0, 0.0))
    assert {each.path for each in store} == {kept, old}


def test_voiding_takes_all_entries_of_the_same_conditions_and_no_others(store, folder):
    one, other = jobs_of(folder, trials=2)
    elsewhere = conditions_of(policy="another")
    for conditions, job in ((HERE, one), (HERE, other), (elsewhere, one)):
        store.put(conditions, conditions.key(job), row_of(job, folder), job.mcap)
    assert store.void(HERE) == 2
    assert [store.find(HERE, HERE.key(job)) for job in (one, other)] == [None, None]
    assert store.find(elsewhere, elsewhere.key(one)) is not None
    assert store.void(HERE) == 0


@pytest.mark.parametrize(("text", "size"), [("", 5 * 10**9), ("0", 0), ("0.25", 250_000_000)])
def test_the_size_is_a_number_of_gigabytes(monkeypatch, text, size):
    monkeypatch.setenv("NW_EVAL_CACHE_GB", text)
    assert limit_bytes() == size


@pytest.mark.parametrize("text", ["much", "-1", "nan", "inf", "1e99"])
def test_a_size_that_is_none_is_refused(monkeypatch, text):
    monkeypatch.setenv("NW_EVAL_CACHE_GB", text)
    with pytest.raises(UsageError, match=f"NW_EVAL_CACHE_GB is '{text}'; give a size in GB"):
        limit_bytes()


def test_the_folder_of_a_store_that_is_not_there_holds_nothing(store):
    assert list(store) == []
    assert store.find(HERE, "0" * 64) is None
    assert store.prune(0) == []


def test_the_first_run_is_told_where_the_cache_is_and_how_large(tmp_path, monkeypatch):
    monkeypatch.setenv("NW_EVAL_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("NW_EVAL_CACHE_GB", "2.5")
    told = told_of_cache()
    assert str(tmp_path / "cache") in told
    assert "up to 2.5 GB" in told
    monkeypatch.setenv("NW_EVAL_CACHE_GB", "0")
    assert told_of_cache() == ""
    monkeypatch.setenv("NW_EVAL_CACHE_GB", "2.5")
    TrialStore.of_user()
    assert told_of_cache() == ""
