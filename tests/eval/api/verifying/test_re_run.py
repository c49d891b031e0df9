"""Trials of a real run, run again: the same bits, and what was forged is found by them."""

import shutil
from dataclasses import replace
from hashlib import sha256

import pytest
from command_line import ends
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from nw_eval import api
from nw_eval.api.verifying_trials import partings, partings_apart
from nw_gate.results.ended import write_trials
from nw_gate.results.journal import Journal, read_journal
from nw_gate.results.provenance import read_run_info, write_run_info
from nw_gate.results.run_folder import RunFolder

SUITE = """\
nw-eval: 1
name: quick
robot: go1
policy: stand
trials: 3
seed: 5
episode: {duration: 0.3}
scenes: [flat/carpet_room]
record: all
"""
FIRST, SECOND, THIRD = (f"flat-carpet_room-{index:03d}" for index in range(3))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return the folder of a run of three trials, with the pictures of an onlooker's camera."""
    folder = tmp_path_factory.mktemp("verified")
    (folder / "quick.yaml").write_text(SUITE)
    return api.run(folder / "quick.yaml", out=folder / "run", workers=1).folder


@pytest.fixture
def run(whole, tmp_path):
    return RunFolder(path=shutil.copytree(whole, tmp_path / "run"))


def forge(run, *, rows=None, **info):
    """Write a run anew with other rows and another run.json: every sum and the root fit."""
    contents = read_journal(run.journal)
    kept = [(rows or {}).get(row.trial_id, lambda row: row)(row) for row in contents.rows]
    run.journal.unlink()
    with Journal.create(run.journal, contents.header) as journal:
        for row in kept:
            journal.append(row)
    changed = read_run_info(run.run_json).model_copy(update=info)
    write_run_info(run.run_json, write_trials(run, changed, kept))


def unchanged(_topic, data):
    return data


def rewrite(log, *, change=unchanged):
    """Write a log anew as another program would, whole, with other bytes for the same messages.

    Args:
        log: the file.
        change: gives what is written for a message, by its topic; None = nothing.
    """
    with log.open("rb") as stream:
        reader = make_reader(stream)
        messages, metadata = list(reader.iter_messages()), list(reader.iter_metadata())
    with log.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start()
        channels = {}
        for schema, channel, message in messages:
            data = change(channel.topic, message.data)
            if data is None:
                continue
            if channel.topic not in channels:
                known = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(
                    channel.topic, channel.message_encoding, known
                )
            writer.add_message(channels[channel.topic], message.log_time, data, message.log_time)
        for record in metadata:
            writer.add_metadata(record.name, record.metadata)
        writer.finish()


def with_another_picture(run, trial):
    """Change one byte of the last picture in a log, and return what its row is to say of it."""
    log = run.mcap("flat/carpet_room", trial)
    pictures = []

    def flip(topic, data):
        pictures.append(topic == "/camera/ego")
        is_last = sum(pictures) == 3 and pictures[-1]
        middle = len(data) // 2
        return data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :] if is_last else data

    rewrite(log, change=flip)
    digest, size = sha256(log.read_bytes()).hexdigest(), log.stat().st_size
    return lambda row: replace(row, mcap_sha256=digest, mcap_bytes=size)


def test_a_run_gives_the_same_bits_again_and_says_so(run, capsys):
    before = {path: path.stat().st_mtime_ns for path in run.path.rglob("*")}
    assert ends("verify", run.path, "--workers", "1") == 0
    out = capsys.readouterr().out
    assert "as the run ended: 3 rows and 3 logs" in out
    assert "states, actions and the log, images included, byte for byte" in out
    assert "re-run: 1 of 1 trial identical, drawn from 3 by --seed " in out
    assert {path: path.stat().st_mtime_ns for path in run.path.rglob("*")} == before


def test_what_was_forged_with_all_its_sums_is_found_by_running_it_again(run):
    better = {"success": 1.0, "completed": True, "outcome": "completed"}
    rows = {
        FIRST: lambda row: replace(row, **better, waypoints_reached=row.waypoints_total),
        SECOND: with_another_picture(run, SECOND),
    }
    forge(run, rows=rows)
    run.mcap("flat/carpet_room", THIRD).unlink()
    verified = api.verify(run.path, trials="100%", seed=1, policy="stand", workers=1)
    assert verified.repeats.seed == 1
    assert [each.what for each in verified.files.findings] == ["missing"], "the third's log"
    first, second, third = verified.repeats.trials
    assert (first.trial, second.trial, third.trial) == (FIRST, SECOND, THIRD)
    assert {"success", "outcome"} <= {each.name for each in first.differences}
    assert first.log == "same"
    assert second.differences == ()
    assert dict(second.partings) == {"image": 10}, "pictures at 10 Hz, the last one at 0.2 s"
    assert third.is_identical
    assert third.log == "same", "its row knows the digest of the log that is gone"
    assert verified.exit_code == 4


def test_logs_of_other_bytes_are_compared_message_by_message(run):
    first, second = (run.mcap("flat/carpet_room", trial) for trial in (FIRST, SECOND))
    again = first.with_name("again.mcap")
    shutil.copy(first, again)
    rewrite(again)
    assert again.read_bytes() != first.read_bytes()
    assert partings(first, again) == {}
    rewrite(again, change=lambda topic, data: None if topic == "/camera/ego" else data)
    assert partings(first, again) == {}, "which pictures are kept is the recording's choice"
    rewrite(again, change=lambda topic, data: None if topic == "/nw/state" else data)
    assert partings(first, again) == {"state": 0}
    assert set(partings(first, second)) >= {"state", "image"}
    again.write_bytes(first.read_bytes()[:-2000])
    assert partings_apart(again, first) is None, "it ends in the middle"


@pytest.mark.parametrize("other", ["cpu", "code"])
def test_a_run_of_another_machine_or_version_is_looked_at_and_not_run_again(run, other, capsys):
    info = read_run_info(run.run_json)
    forge(run, engine={**info.engine, other: "another"})
    assert ends("verify", run.path) == 5
    out = capsys.readouterr().out
    assert "as the run ended: 3 rows" in out
    assert f"nothing was re-run: trials cannot be compared exactly here: {other} " in out


def test_a_run_whose_policy_was_an_object_or_lies_nowhere_is_looked_at_and_not_run_again(run):
    info = read_run_info(run.run_json)
    forge(run, policy=info.policy.model_copy(update={"card": ""}))
    verified = api.verify(run.path)
    assert "was an object of the process that ran it" in str(verified.repeats.unable)
    assert verified.exit_code == 2
    assert verified.files.findings == ()


def test_options_that_only_running_needs_are_refused_offline(run, capsys):
    assert ends("verify", run.path, "--offline", "--seed", "3") == 2
    assert "--offline runs none" in capsys.readouterr().err
