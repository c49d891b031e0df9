"""The file under a trial's log."""

from contextlib import suppress

import numpy as np
import pytest
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader

from nw_sim.rollout import library
from nw_sim.rollout.mcap import file as file_module
from nw_sim.rollout.mcap.batch import filled
from nw_sim.rollout.mcap.file import CHUNK_BYTES, McapFile
from nw_sim.rollout.mcap.steps import odom_form

STEP = 20_000_000  # ns


def topics(path):
    with path.open("rb") as stream:
        return [channel.topic for _, channel, _ in make_reader(stream).iter_messages()]


def test_the_file_appears_under_its_name_only_when_it_is_whole(tmp_path):
    path = tmp_path / "deep" / "trial.mcap"
    file = McapFile(path, images="keep")
    file.add("/log", 0, Log(message="hello"))
    assert not path.exists()
    size = file.close()
    assert path.stat().st_size == size
    assert list(path.parent.iterdir()) == [path]


def test_a_discarded_file_leaves_nothing(tmp_path):
    file = McapFile(tmp_path / "trial.mcap", images="keep")
    file.add("/log", 0, Log(message="hello"))
    file.discard()
    file.discard()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("images", "keep", "found"),
    [
        ("keep", True, ["/log", "/camera/ego", "/log"]),
        ("decide", True, ["/log", "/camera/ego", "/log"]),
        ("decide", False, ["/log", "/log"]),
        ("drop", True, ["/log", "/log"]),
    ],
)
def test_images_are_kept_decided_on_or_dropped_and_order_stays(tmp_path, images, keep, found):
    path = tmp_path / "trial.mcap"
    made = []
    file = McapFile(path, images=images)
    file.add("/log", 0, Log(message="before"))
    file.add_image("/camera/ego", 1, lambda: made.append(1) or Log(message="a picture"))
    file.add("/log", 2, Log(message="after"))
    file.settle(keep_images=keep)
    file.close()
    assert topics(path) == found
    assert bool(made) == ("/camera/ego" in found), "a picture is made only to be kept"


def test_a_message_that_waits_is_the_one_that_was_added(tmp_path):
    path = tmp_path / "trial.mcap"
    template = Log(message="first")
    file = McapFile(path, images="decide")
    file.add("/log", 0, template)
    template.message = "second"
    file.add("/log", 1, template)
    file.settle(keep_images=False)
    file.close()
    with path.open("rb") as stream:
        read = [Log.FromString(m.data).message for _, _, m in make_reader(stream).iter_messages()]
    assert read == ["first", "second"]


def test_whole_chunks_of_a_log_whose_writer_died_can_be_read(tmp_path):
    rng = np.random.default_rng(0)
    file = McapFile(tmp_path / "trial.mcap", images="keep")
    for k in range(22):
        file.add("/log", k, Log(message=rng.bytes(CHUNK_BYTES // 10).hex()))
    with file.partial.open("rb") as stream:
        records = StreamReader(stream, emit_chunks=False).records
        found = iter(records)
        seen = 0
        with suppress(EndOfFile):  # The file stops where its writer did.
            while record := next(found, None):
                seen += isinstance(record, Message)
    file.discard()
    assert 10 <= seen < 22


def test_images_wait_as_they_are_until_they_would_fill_the_memory(tmp_path, monkeypatch):
    monkeypatch.setattr(file_module, "_MOST_HELD", 250)
    made = []
    file = McapFile(tmp_path / "trial.mcap", images="decide")
    for number in range(4):
        file.add_image(
            "/camera", number, lambda k=number: made.append(k) or Log(message=str(k)), holds=100
        )
    assert made == [2, 3], "the first two wait"
    file.settle(keep_images=True)
    file.close()
    assert made == [2, 3, 0, 1]
    with (tmp_path / "trial.mcap").open("rb") as stream:
        read = [Log.FromString(m.data).message for _, _, m in make_reader(stream).iter_messages()]
    assert read == ["0", "1", "2", "3"]


class Counted:
    """Notes of numbers, each a message on two topics."""

    def __init__(self):
        self.notes = []

    def take(self, channels):
        times = np.array(self.notes)
        both = [channels(topic, PoseInFrame) for topic in ("/a", "/b")]
        rows = np.repeat(times, 7).reshape(-1, 7).astype(float)
        self.notes = []
        return [(range(len(times)), filled(both, [odom_form()] * 2, times, (rows, -rows)))]


@pytest.mark.parametrize(("images", "seconds"), [("keep", 2), ("drop", 12)])
def test_messages_of_notes_stand_where_they_were_noted(tmp_path, images, seconds):
    path = tmp_path / "trial.mcap"
    file, noted = McapFile(path, images=images), Counted()
    for number in range(2000):  # 40 s
        noted.notes.append(number * STEP)
        file.add_noted(noted, number / 50)
        file.add("/log", number * STEP, Log(message=str(number)))
        assert len(noted.notes) <= 50 * seconds + 1
    file.close()
    with path.open("rb") as stream:
        read = [(c.topic, m.log_time, m.data) for _, c, m in make_reader(stream).iter_messages()]
    assert [topic for topic, _, _ in read] == ["/a", "/b", "/log"] * 2000
    assert [time for _, time, _ in read] == [k * STEP for k in range(2000) for _ in range(3)]
    last = PoseInFrame.FromString(read[-2][2])
    assert (last.pose.position.x, last.pose.orientation.w) == (-1999.0 * STEP, -1999.0 * STEP)
    assert last.timestamp.nanos == 1999 * STEP % 10**9


def test_only_the_scenes_used_last_are_kept(monkeypatch):
    made = []
    monkeypatch.setattr(
        library, "open_scene", lambda name, _collision: made.append(name) or name.upper()
    )
    recent = library.Library(scenes=2)
    assert [recent.scene(name) for name in "abacab"] == list("ABACAB")
    # `b` was used longest ago when `c` came, and is made again at the end.
    assert made == ["a", "b", "c", "b"]
