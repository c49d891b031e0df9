"""What logs showed is kept: the same pages, and what is damaged or another's is not believed."""

import os
import shutil
from dataclasses import replace
from io import BytesIO

import pytest
from PIL import Image

from nw_eval import api
from nw_eval.api import evidence
from nw_eval.api.evidence import KeptEvidence, WantedLog, gather_evidence
from nw_eval.api.evidence_drawn import with_drawn
from nw_eval.api.reports import as_begun, written
from nw_gate.results.evidence_check import present_logs
from nw_gate.results.provenance import CacheInfo
from nw_gate.results.run_folder import RunFolder

ROOM = {"picture": 40_000, "clip": 125_000}


@pytest.fixture
def store(tmp_path):
    folder = tmp_path / "evidence"
    folder.mkdir()
    return KeptEvidence(folder=folder, policy=("card", "checkpoint"))


@pytest.fixture
def filled(store, recorded):
    """Return a store that has what one run's logs show, and that."""
    return store, gathered(recorded.folder, recorded.rows, store)


def gathered(folder, rows, store=None):
    return gather_evidence(RunFolder(path=folder), rows, store)


def nothing_is_read(monkeypatch):
    def read(*_):
        raise AssertionError("a log is read")

    monkeypatch.setattr(evidence, "read_apart", read)


def reads(monkeypatch):
    """Return a list that grows whenever logs are read."""
    count, read = [], evidence.read_apart
    monkeypatch.setattr(evidence, "read_apart", lambda *all_: count.append(1) or read(*all_))
    return count


def as_text(evidence):
    pictures = [place.picture for place in evidence.places]
    return repr((evidence.clips, pictures, evidence.remarks, [p.points for p in evidence.paths]))


def test_pages_are_byte_for_byte_those_of_logs_that_are_read(filled, run, tmp_path, monkeypatch):
    store, _ = filled
    folder, _ = run
    api.report(folder, out=tmp_path / "read.md")
    nothing_is_read(monkeypatch)
    written(as_begun(folder), tmp_path / "kept.md", kept=store)
    for name in ("md", "html"):
        page = (tmp_path / f"kept.{name}").read_bytes()
        assert page == (tmp_path / f"read.{name}").read_bytes()
    assert b"image/webp" in page


def test_a_run_that_ends_asks_what_was_kept_and_one_without_the_cache_does_not(
    recorded, tmp_path, monkeypatch
):
    monkeypatch.setenv("NW_EVAL_CACHE", str(tmp_path / "cache"))
    with_cache = recorded.info.model_copy(update={"cache": CacheInfo()})
    found = KeptEvidence.of_run(with_cache)
    assert found.folder.stat().st_mode & 0o077 == 0
    assert found.policy == (
        recorded.info.policy.card_digest,
        recorded.info.policy.checkpoint_digest,
    )
    assert recorded.info.cache.off == "NW_EVAL_CACHE_GB=0"
    assert KeptEvidence.of_run(recorded.info) is None
    assert KeptEvidence.of_run(with_cache.model_copy(update={"cache": None})) is None


@pytest.mark.parametrize(
    "damage",
    [
        lambda file: file.write_bytes(b""),
        lambda file: file.write_bytes(file.read_bytes()[:-1]),
        lambda file: file.write_bytes(
            file.read_bytes().replace(b'"walked":[[', b'"walked":[[1', 1)
        ),
        lambda file: file.write_bytes(b"\0" * 2000),
        lambda file: (file.unlink(), file.mkdir()),
        lambda file: (file.unlink(), os.mkfifo(file)),
        lambda file: os.truncate(file, evidence._MOST_FILE + 1),
    ],
    ids=["empty", "cut", "changed", "zeros", "a folder", "a pipe", "huge"],
)
def test_what_is_damaged_is_none_and_logs_are_read(filled, recorded, damage, monkeypatch):
    store, before = filled
    (file,) = store.folder.iterdir()
    damage(file)
    count = reads(monkeypatch)
    assert as_text(gathered(recorded.folder, recorded.rows, store)) == as_text(before)
    assert count


def test_the_file_of_other_logs_is_none_under_whatever_name(filled, recorded, monkeypatch):
    store, _ = filled
    (file,) = store.folder.iterdir()
    one = recorded.rows[:1]
    gathered(recorded.folder, one, store)
    (other,) = set(store.folder.iterdir()) - {file}
    shutil.copy(file, other)
    count = reads(monkeypatch)
    assert len(gathered(recorded.folder, one, store).paths) == 1
    assert count


def test_a_key_has_every_log_s_bytes_what_of_it_is_wanted_and_the_policy(store, tmp_path):
    log = tmp_path / "a.mcap"
    log.write_bytes(b"one")
    wanted = WantedLog(path=log, scene="flat/a", clip=False)
    keys = [
        store.key([wanted], ROOM),
        store.key([wanted, wanted], ROOM),
        store.key([replace(wanted, clip=True)], ROOM),
        store.key([replace(wanted, scene="flat/b")], ROOM),
        store.key([wanted], ROOM | {"picture": 1}),
        replace(store, policy=("card", "another")).key([wanted], ROOM),
    ]
    shutil.copy(log, tmp_path / "b.mcap")
    assert store.key([replace(wanted, path=tmp_path / "b.mcap")], ROOM) == keys[0]
    log.write_bytes(b"two")
    keys.append(store.key([wanted], ROOM))
    assert len(set(keys)) == len(keys)
    log.unlink()
    assert store.key([wanted], ROOM) == ""
    assert store.find("") is None


def test_what_keeps_a_log_from_being_read_is_not_kept(store, run):
    folder, rows = run
    (folder / rows[0].mcap_path).write_bytes(b"no log")
    evidence = gathered(folder, rows, store)
    assert "shows nothing" in " ".join(evidence.remarks)
    assert not list(store.folder.iterdir())


def test_files_that_were_not_used_for_longest_go_first(filled, recorded, monkeypatch):
    store, _ = filled
    (used,) = store.folder.iterdir()
    size = used.stat().st_size
    old = store.folder / "old"
    old.write_bytes(b"x" * size)
    os.utime(old, (1, 1))
    os.utime(used, (2, 2))
    gathered(recorded.folder, recorded.rows, store)
    assert used.stat().st_mtime > 2, "it has been of use"
    monkeypatch.setattr(evidence, "_MOST", 2 * size)
    gathered(recorded.folder, recorded.rows[:1], store)
    assert used in set(store.folder.iterdir())
    assert not old.exists()


def test_a_folder_that_cannot_be_written_costs_nothing(store, recorded):
    store.folder.rmdir()
    store.folder.write_text("a file")
    assert len(gathered(recorded.folder, recorded.rows, store).paths) == len(recorded.rows)


def played(moving):
    """Return the milliseconds that each picture stands."""
    stands = []
    for place in range(moving.n_frames):
        moving.seek(place)
        moving.load()
        stands.append(moving.info["duration"])
    return stands


def test_scenes_and_worst_trials_are_drawn_in_their_colours_and_once(store, recorded, monkeypatch):
    folder = RunFolder(path=recorded.folder)

    def drawn():
        return with_drawn(
            recorded.evidence,
            folder,
            recorded.rows,
            present_logs(folder, recorded.rows),
            digests={name: scene.digest for name, scene in recorded.info.scenes.items()},
            kept=store,
            is_own=False,
        )

    def drawn_again(*_, **__):
        raise AssertionError("they are kept")

    first = drawn()
    assert len(first.clips) == len(recorded.rows)
    for clip in first.clips:
        assert clip.outside is not None
        assert clip.outside.data != clip.data
        with (
            Image.open(BytesIO(clip.outside.data)) as beside,
            Image.open(BytesIO(clip.data)) as seen,
        ):
            # Ten pictures a second, and both begin again at the same time.
            assert beside.n_frames == round(clip.seconds / 0.1) + 2
            assert played(beside)[:-1] == [100] * (beside.n_frames - 2) + [played(beside)[-2]]
            assert sum(played(beside)) == pytest.approx(sum(played(seen)), abs=2)
    (place,) = first.places
    assert place.picture.is_coloured
    assert first.remarks == recorded.evidence.remarks
    monkeypatch.setattr("nw_eval.api.evidence_drawn.drawn_apart", drawn_again)
    again = drawn()
    assert [clip.outside for clip in again.clips] == [clip.outside for clip in first.clips]
    assert again.places[0].picture == place.picture


def test_of_a_run_of_another_scene_nothing_is_drawn(store, recorded, monkeypatch):
    """A name alone does not say which scene it was."""
    folder = RunFolder(path=recorded.folder)
    monkeypatch.setattr("nw_eval.api.evidence_drawn.drawn_apart", None)
    bare = replace(
        recorded.evidence,
        clips=tuple(replace(clip, outside=None) for clip in recorded.evidence.clips),
    )
    logs = present_logs(folder, recorded.rows)
    other = dict.fromkeys(recorded.info.scenes, "00" * 32)
    found = with_drawn(bare, folder, recorded.rows, logs, digests=other, kept=store, is_own=False)
    assert (found.clips, found.remarks) == (bare.clips, bare.remarks)
    assert found.places[0].picture == bare.places[0].picture
