"""Logs that a disk damaged or a stranger made: one sentence, soon, and little memory."""

import json
import os
import random
import tracemalloc
from collections import Counter
from io import BytesIO

import numpy as np
import pytest
import zstandard
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk, DataEnd, Footer, Header, Metadata
from mcap.writer import MCAP0_MAGIC, Writer
from PIL import Image

from nw_base.errors import StoreError, UsageError
from nw_eval.cli import main
from nw_sim.rollout.mcap.file import McapFile
from nw_sim.rollout.mcap.images import image_message
from nw_sim.rollout.mcap.messages import SimState
from nw_sim.rollout.mcap.reader import LogReader
from nw_sim.rollout.record import TRIAL, VERDICT, trial_metadata
from nw_sim.rollout.replaying.logged import read_logged_trial
from nw_sim.rollout.replaying.takeover import replay

TRIES = 500


@pytest.fixture
def log(tmp_path):
    """Return a small log of everything that is read back."""
    path = tmp_path / "trial.mcap"
    file = McapFile(path, images="keep")
    file.add_metadata("nw.trial", {"trial": "t", "job": "{}"})
    file.attach("suite.yaml", "text/plain", b"nw-eval: 1\n")
    for step in range(30):
        transforms = FrameTransforms()
        transforms.transforms.add(child_frame_id="trunk").translation.x = step / 10
        file.add("/tf", step, transforms)
        file.add("/nw/state", step, SimState(step=step, world=bytes(range(200))))
    rgb = np.random.default_rng(0).integers(0, 255, (24, 32, 3), dtype=np.uint8)
    file.add("/camera/ego", 30, image_message(30, "camera/ego", rgb))
    file.close()
    return path


def everything(path):
    """Read a log in every way there is."""
    reader = LogReader(path)
    return (
        reader.metadata(),
        reader.attachments(),
        reader.topics(),
        [state.SerializeToString() for state in reader.states()],
        [(time, frame.tobytes()) for time, frame in reader.frames()],
        [(time, {k: (p.tolist(), q.tolist()) for k, (p, q) in x.items()})
         for time, x in reader.poses()],
        [(topic, time) for topic, time, _ in reader.messages()],
    )  # fmt: skip


def test_a_log_that_is_whole_is_read_in_every_way(log):
    metadata, attachments, topics, states, frames, poses, messages = everything(log)
    assert metadata == {"nw.trial": {"trial": "t", "job": "{}"}}
    assert attachments == {"suite.yaml": b"nw-eval: 1\n"}
    assert topics == {"/tf": 30, "/nw/state": 30, "/camera/ego": 1}
    assert (len(states), len(frames), len(poses), len(messages)) == (30, 1, 30, 61)
    assert poses[-1][1]["trunk"][0] == [2.9, 0.0, 0.0]


def test_no_damage_is_more_than_a_sentence(log):
    whole, rng, counts = log.read_bytes(), random.Random(4), Counter()
    for _ in range(TRIES):
        data = bytearray(whole)
        kind = rng.randrange(4)
        at = rng.randrange(len(data))
        if kind == 0:
            data[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            del data[at:]
        elif kind == 2:
            data[at:at] = rng.randbytes(rng.choice([1, 8, 100]))
        else:
            data[at : at + 8] = rng.choice(
                [bytes(8), b"\xff" * 8, b"\x00\x00\x00\x00\x00\x00\x00\x80"]
            )
        log.write_bytes(data)
        try:
            everything(log)
            counts["read"] += 1
        except StoreError as error:
            counts["refused"] += 1
            said = str(error)
            if str(log) not in said or not said.isprintable():
                pytest.fail(said)
    assert counts["refused"] > 0.5 * TRIES


@pytest.mark.parametrize("data", [b"", b"x", MCAP0_MAGIC, MCAP0_MAGIC * 2, bytes(500)])
def test_a_file_of_hardly_anything_is_no_log(tmp_path, data):
    path = tmp_path / "tiny.mcap"
    path.write_bytes(data)
    with pytest.raises(StoreError, match=r"tiny\.mcap is damaged, or not a log of nw-eval"):
        read_logged_trial(path)


def test_what_is_no_file_is_not_opened(tmp_path):
    os.mkfifo(tmp_path / "pipe.mcap")
    (tmp_path / "zero.mcap").symlink_to("/dev/zero")
    for path in (tmp_path, tmp_path / "pipe.mcap", tmp_path / "zero.mcap"):
        with pytest.raises(StoreError, match="it is not a file"):
            read_logged_trial(path)
    with pytest.raises(StoreError, match=r"cannot read .*No such file"):
        read_logged_trial(tmp_path / "none.mcap")


def write(path, *records):
    """Write an MCAP file of records as they are."""
    builder = RecordBuilder()
    builder.write(MCAP0_MAGIC)
    for record in (Header("", ""), *records, DataEnd(0), Footer(0, 0, 0)):
        record.write(builder)
    builder.write(MCAP0_MAGIC)
    path.write_bytes(builder.end())


def chunk(data, *, size=None, compression="zstd", crc=0):
    return Chunk(
        compression=compression,
        data=data,
        message_start_time=0,
        message_end_time=0,
        uncompressed_crc=crc,
        uncompressed_size=size if size is not None else len(data),
    )


ZEROS = zstandard.compress(bytes(60 * 2**20))
"""60 MiB in 5 KB."""


@pytest.mark.parametrize(
    ("record", "words"),
    [
        (chunk(ZEROS, size=60 * 2**20), "unpacks to 62914560"),
        (chunk(ZEROS, size=2**40), "unpacks to 1099511627776"),
        (chunk(ZEROS, size=1000), "not the one in its header"),
        (chunk(b"no zstd at all", size=10), "damaged"),
        (chunk(b"abc", compression="br"), "compressed by 'br', not zstd or lz4"),
        (chunk(b"abc", compression="lz4"), "a chunk's size is not the one"),
        (chunk(b"\x05" + b"\xff" * 8 + b"abc", compression=""), "more in it than it can have"),
        (chunk(b"abc", compression="", crc=5), "checksum"),
        (chunk(b"\x05\x02\0\0\0\0\0\0\0ab", compression=""), "damaged"),
    ],
)
def test_a_chunk_that_lies_about_its_size_is_not_unpacked(tmp_path, record, words):
    path = tmp_path / "bomb.mcap"
    write(path, record)
    tracemalloc.start()
    try:
        with pytest.raises(StoreError, match=words):
            LogReader(path).states()
        assert tracemalloc.get_traced_memory()[1] < 20 * 2**20
    finally:
        tracemalloc.stop()


def test_a_chunk_of_millions_of_messages_is_given_up(tmp_path, monkeypatch):
    monkeypatch.setattr("nw_sim.rollout.mcap.reader._MOST_RECORDS", 1000)
    nothing = b"\x07" + bytes(8)  # A record without content, of a kind that chunks do not have.
    write(tmp_path / "many.mcap", chunk(nothing * 1001, compression=""))
    with pytest.raises(StoreError, match="more in it than it can have"):
        LogReader(tmp_path / "many.mcap").topics()
    write(tmp_path / "many.mcap", *[Metadata(name="a", metadata={})] * 1001)
    with pytest.raises(StoreError, match="over 1000 records"):
        LogReader(tmp_path / "many.mcap").metadata()


def test_texts_are_bounded_before_they_are_read(tmp_path, monkeypatch):
    monkeypatch.setattr("nw_sim.rollout.mcap.reader._MOST_TEXTS", 2**20)
    texts = {str(number): "" for number in range(50_000)}
    write(tmp_path / "texts.mcap", *[Metadata(name="a", metadata=texts)] * 2)
    with pytest.raises(StoreError, match="over 1 MiB of texts"):
        LogReader(tmp_path / "texts.mcap").metadata()


def messages_of(path, schema, *datas, times=(), descriptors=b""):
    """Write messages on /camera/ego of a schema that a stranger made."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        number = writer.register_schema(schema, "protobuf", descriptors)
        channel = writer.register_channel("/camera/ego", "protobuf", number)
        for index, data in enumerate(datas):
            time = times[index] if times else 0
            writer.add_message(channel, time, data, time)
        writer.finish()


def test_a_logs_own_schemas_are_not_built(tmp_path):
    path = tmp_path / "schema.mcap"
    circle = FileDescriptorSet(
        file=[
            FileDescriptorProto(name="a", dependency=["b"]),
            FileDescriptorProto(name="b", dependency=["a"]),
        ]
    ).SerializeToString()
    messages_of(path, "strange.Thing", b"", descriptors=circle)
    with pytest.raises(StoreError, match="/camera/ego has messages of an unknown kind"):
        list(LogReader(path).messages())
    picture = BytesIO()
    Image.new("RGB", (4, 3)).save(picture, "JPEG")
    data = CompressedImage(data=picture.getvalue()).SerializeToString()
    messages_of(path, "foxglove.CompressedImage", data, descriptors=circle)
    [(_, frame)] = LogReader(path).frames()
    assert frame.shape == (3, 4, 3)


def test_pictures_and_messages_that_are_none_are_told(tmp_path):
    path = tmp_path / "picture.mcap"
    messages_of(path, "foxglove.CompressedImage", b"\xff\xff\xff")
    with pytest.raises(StoreError, match="is damaged"):
        list(LogReader(path).frames())
    for kind, words in {
        "JPEG": "5000 x 4000 p",
        "PNG": "5000 x 4000 p",
        "GIF": "is damaged",
    }.items():
        picture = BytesIO()
        Image.new("L", (5000, 4000)).save(picture, kind)
        data = CompressedImage(data=picture.getvalue()).SerializeToString()
        messages_of(path, "foxglove.CompressedImage", data)
        with pytest.raises(StoreError, match=words):
            list(LogReader(path).frames())


def test_a_message_of_many_megabytes_is_not_decoded(tmp_path):
    path = tmp_path / "large.mcap"
    rng = np.random.default_rng(0)
    data = CompressedImage(data=rng.bytes(17 * 2**20)).SerializeToString()
    messages_of(path, "foxglove.CompressedImage", data)
    with pytest.raises(StoreError, match="a message has over 16 MiB"):
        list(LogReader(path).messages())


def test_messages_that_go_back_in_time_are_told(tmp_path):
    path = tmp_path / "back.mcap"
    messages_of(path, "foxglove.CompressedImage", b"", b"", times=(5, 4))
    with pytest.raises(StoreError, match="not in order of time"):
        LogReader(path).topics()


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"duration": float("nan")}, "duration: nan s is not between 0 and 600"),
        ({"duration": float("inf")}, "duration: inf s"),
        ({"duration": -1.0}, "duration: -1.0 s"),
        ({"duration": 1e9}, "duration: "),
        ({"trial.suite_seed": -1}, "suite_seed: -1 does not fit"),
        ({"trial.index": 10**12}, "index: 1000000000000 is not"),
        ({"trial.perturbation": [["friction", float("nan")]]}, "perturbation: friction is nan"),
    ],
)
def test_a_log_of_a_trial_that_no_suite_has_is_damaged(make_job, tmp_path, fields, words):
    metadata = trial_metadata(make_job())
    job = json.loads(metadata["job"])
    for name, value in fields.items():
        (job["trial"] if name.startswith("trial.") else job)[name.rpartition(".")[2]] = value
    path = tmp_path / "gift.mcap"
    file = McapFile(path, images="drop")
    file.add_metadata(TRIAL, {**metadata, "job": json.dumps(job)})
    file.add_metadata(VERDICT, {"status": "ok"})
    file.close()
    with pytest.raises(StoreError, match=words):
        replay(path)


@pytest.mark.parametrize("start", ["nan", "inf", "-1"])
def test_a_start_that_is_no_time_is_a_usage_error(log, start, capsys):
    with pytest.raises(UsageError, match="give seconds, at least 0"):
        replay(log, start=float(start))
    with pytest.raises(SystemExit) as caught:
        main(["replay", str(log), "--start", start])
    assert caught.value.code == 2
    assert "--start" in capsys.readouterr().err
