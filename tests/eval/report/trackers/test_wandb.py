"""What W&B keeps for its next upload is what was to be shown."""

import json
import struct

import pytest

from nw_eval.reporting.trackers.tracked import track


@pytest.fixture
def wandb(at_home):  # noqa: ARG001 - it reads its variables there.
    """The library, which reads its variables once: again for each test."""
    module = pytest.importorskip("wandb")
    yield module
    module.teardown()


@pytest.fixture
def kept(wandb, tmp_path):
    """Return a reader of what each run kept, the earliest first."""
    from wandb.proto.wandb_internal_pb2 import Record

    def read():
        wandb.teardown()  # Its process writes the last of them.
        files = sorted(tmp_path.glob("wandb/offline-run-*/*.wandb"))
        return [[Record.FromString(data) for data in chunks(file.read_bytes())] for file in files]

    return read


def chunks(log):
    """The records of a log of LevelDB's kind: behind 7 bytes, blocks of 32 KiB with pieces."""
    place, whole = 7, b""
    while place + 7 <= len(log):
        if 2**15 - place % 2**15 < 7:
            place += 2**15 - place % 2**15
        _, length, kind = struct.unpack_from("<IHB", log, place)
        whole += log[place + 7 : place + 7 + length]
        place += 7 + length
        if kind in {1, 4}:  # The whole of a record, or its last piece.
            yield whole
            whole = b""


def run_of(records):
    return next(record.run for record in records if record.WhichOneof("record_type") == "run")


def summary_of(records):
    return {
        "/".join(item.nested_key) or item.key: json.loads(item.value_json)
        for record in records
        for item in record.summary.update
    }


def test_a_run_of_its_own_has_verdict_scores_and_report(tracked, kept):
    run = tracked(reached=3)
    track("wandb", run)
    (records,) = kept()
    own = run_of(records)
    assert (own.run_id, own.display_name, own.project) == (run.id, run.title, "nw-eval")
    summary = summary_of(records)
    assert summary["nw-eval/hurdles/all/success"] == 0.75
    assert summary["nw-eval/hurdles/success/hurdles/three_low"] == 0.75
    assert summary["nw-eval/hurdles/verdict"] == "INCONCLUSIVE"
    (artifact,) = (r.artifact for r in records if r.WhichOneof("record_type") == "artifact")
    clip, report = sorted(entry.path for entry in artifact.manifest.contents)
    assert clip.startswith("clips/a._b_-000-")
    assert report == "report.md"
    assert not [r for r in records if r.WhichOneof("record_type") == "history"]


def test_a_second_time_is_the_same_run(tracked, kept):
    track("wandb", tracked(reached=3))
    track("wandb", tracked(reached=1))
    first, second = kept()
    assert run_of(first).run_id == run_of(second).run_id
    assert summary_of(second)["nw-eval/hurdles/all/success"] == 0.25


def test_the_run_of_a_training_is_the_one_that_the_environment_names(tracked, kept, monkeypatch):
    monkeypatch.setenv("WANDB_RUN_ID", "training7")
    monkeypatch.setenv("WANDB_PROJECT", "walking")
    track("wandb", tracked())
    (records,) = kept()
    assert (run_of(records).run_id, run_of(records).project) == ("training7", "walking")


def test_strangers_names_are_keys_of_their_own(hostile, kept):
    track("wandb", hostile)
    (records,) = kept()
    summary = summary_of(records)
    assert {key: summary[key] for key in hostile.numbers} == dict(hostile.numbers)
    assert run_of(records).run_id == hostile.id
