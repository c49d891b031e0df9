"""The writer of MCAP files and the forms of messages, against the packages that define both."""

from io import BytesIO

import mujoco
import numpy as np
import pytest
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import SeekingReader
from mcap.writer import Writer
from mcap_protobuf.schema import register_schema

from nw_eval.rollout.mcap.content.body import (
    joint_rows,
    joints_form,
    odom_form,
    transform_rows,
    transforms_form,
    twist_rows,
)
from nw_eval.rollout.mcap.content.numbers import observation_form, values_of
from nw_eval.rollout.mcap.content.policy_step import policy_step
from nw_eval.rollout.mcap.form import BLANK_TIME, Form
from nw_eval.rollout.mcap.messages import Observation, PolicyStep
from nw_eval.rollout.mcap.stamps import stamp
from nw_eval.rollout.mcap.writer import CHUNK_BYTES, McapWriter

TIMES = [0, 20_000_000, 980_000_000, 1_000_000_000, 12_340_000_000, 599_980_000_000]


def messages():
    """Yield topic, time and message: enough for three chunks."""
    rng = np.random.default_rng(0)
    for k in range(30):
        yield "/log", k, Log(message=rng.bytes(CHUNK_BYTES // 24).hex())
        if k % 3 == 0:
            yield "/pose", k, PoseInFrame(frame_id="world")


def ours():
    stream = BytesIO()
    writer = McapWriter(stream, library="x")
    writer.metadata("texts", {"a": "b"})
    writer.attachment("file", "text/plain", b"content")
    channels = {}
    for topic, time, message in messages():
        if topic not in channels:
            channels[topic] = writer.channel(topic, type(message))
        writer.message(channels[topic], time, message.SerializeToString())
    writer.finish()
    return stream


def theirs():
    stream = BytesIO()
    writer = Writer(stream, chunk_size=CHUNK_BYTES)
    writer.start(library="x")
    writer.add_metadata("texts", {"a": "b"})
    writer.add_attachment(0, 0, "file", "text/plain", b"content")
    channels = {}
    for topic, time, message in messages():
        if topic not in channels:
            schema = register_schema(writer, type(message))
            channels[topic] = writer.register_channel(topic, "protobuf", schema)
        writer.add_message(channels[topic], time, message.SerializeToString(), time)
    writer.finish()
    return stream


def told(stream):
    """Return all that the package's reader, which trusts indices and checks sums, finds."""
    stream.seek(0)
    reader = SeekingReader(stream, validate_crcs=True)
    summary = reader.get_summary()
    found = [(c.topic, s.name, s.data, m.log_time, m.data) for s, c, m in reader.iter_messages()]
    late = [(c.topic, m.log_time) for _, c, m in reader.iter_messages(["/pose"], reverse=True)]
    texts = [(record.name, record.metadata) for record in reader.iter_metadata()]
    files = [(record.name, record.media_type, record.data) for record in reader.iter_attachments()]
    chunks = [
        (
            c.message_start_time,
            c.message_end_time,
            c.uncompressed_size,
            set(c.message_index_offsets),
        )
        for c in summary.chunk_indexes
    ]
    return found, late, texts, files, chunks, vars(summary.statistics), summary.channels


def test_a_reader_finds_what_it_finds_in_a_file_of_the_package_s_own_writer():
    found, expected = told(ours()), told(theirs())
    assert len(found[0]) == 40
    assert len(found[4]) > 2, "several chunks"
    assert found == expected


def test_a_file_without_messages_is_whole():
    stream = BytesIO()
    McapWriter(stream, library="x").finish()
    stream.seek(0)
    reader = SeekingReader(stream, validate_crcs=True)
    assert list(reader.iter_messages()) == []
    assert reader.get_summary().statistics.message_count == 0


def filled_once(form, time_ns, numbers):
    return form.filled(np.array([time_ns]), numbers[np.newaxis])[0].tobytes()


@pytest.mark.parametrize("time_ns", TIMES)
def test_a_filled_form_reads_as_the_message_that_it_stands_for(time_ns):
    numbers = np.random.default_rng(1).normal(size=7)
    numbers[2] = 0.0
    form = odom_form()
    rows = np.stack([np.ones(7), numbers, np.zeros(7)])
    for found in form.filled(np.array([5, time_ns, 0]), rows)[[1]]:
        read = PoseInFrame.FromString(found.tobytes())
        p, q = read.pose.position, read.pose.orientation
        assert [p.x, p.y, p.z, q.w, q.x, q.y, q.z] == numbers.tolist()
        assert read.timestamp.seconds * 10**9 + read.timestamp.nanos == time_ns
        assert read.frame_id == "world"


def test_forms_of_many_parts_put_each_number_in_its_place():
    transforms = transforms_form(("a", "b"))
    read = transforms.kind.FromString(filled_once(transforms, 40, np.arange(14.0)))
    assert [t.child_frame_id for t in read.transforms] == ["a", "b"]
    assert [t.timestamp.nanos for t in read.transforms] == [40, 40]
    assert (read.transforms[1].translation.x, read.transforms[1].rotation.z) == (7.0, 13.0)
    joints = joints_form(("hip", "knee"))
    read = joints.kind.FromString(
        filled_once(joints, 0, joint_rows([([0.1, 3.0], [1.0, 4.0], [2.0, 5.0])]))
    )
    assert [(j.name, j.effort) for j in read.joints] == [("hip", 2.0), ("knee", 5.0)]
    assert read.joints[0].position == np.float32(0.1)


def test_numbers_of_a_form_are_kept_bit_for_bit():
    rng = np.random.default_rng(2)
    values = rng.integers(0, 2**32, 4096, dtype=np.uint32).view(np.float32).reshape(64, 64)
    form = observation_form(values.shape, (("a", 1000), ("b", 3095), ("c", 1)))
    read = Observation.FromString(filled_once(form, 0, values))
    finite = np.isfinite(values)
    np.testing.assert_array_equal(values_of(read)[finite], values[finite])
    assert values_of(read).shape == (64, 64)
    assert [len(term.values) for term in read.terms] == [1000, 3095, 1]


def test_a_blank_that_is_not_there_or_there_twice_is_refused():
    message = Observation(timestamp=BLANK_TIME, shape=[1])
    for blank in (b"none", b"\xff\xff"):
        with pytest.raises(ValueError, match="unpack"):
            Form(message, [blank])


def test_frames_of_cameras_are_carried_by_the_trunk_and_rates_are_the_trunks():
    rng = np.random.default_rng(4)
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body name='trunk'><freejoint/><geom size='.1'/>"
        "<body name='eye' pos='.3 -.1 .2' quat='.6 .8 0 0'><geom size='.1'/></body>"
        "</body></worldbody></mujoco>"
    )
    data, notes, expected, rates = mujoco.MjData(model), [], [], []
    for _ in range(5):
        data.qpos[:], data.qvel[:] = rng.normal(size=7), rng.normal(size=6)
        mujoco.mj_forward(model, data)
        notes.append((data.xpos.copy(), data.xquat.copy()))
        expected.append(np.concatenate([data.xpos[2], data.xmat[2]]))
        turned = data.xmat[1].reshape(3, 3).T @ data.qvel[:3]
        rates.append((data.qvel.copy(), np.concatenate([turned, data.qvel[3:]])))
    camera = np.concatenate([model.body_pos[2], model.body_quat[2]])
    rows = transform_rows(notes, bodies=[1], cameras=[camera])
    assert rows.shape == (5, 2, 7)
    for row, wanted in zip(rows[:, 1], expected, strict=True):
        matrix = np.empty(9)
        mujoco.mju_quat2Mat(matrix, row[3:].copy())
        np.testing.assert_allclose(np.concatenate([row[:3], matrix]), wanted, atol=1e-6)
    found = twist_rows([(n, v) for n, (v, _) in zip(notes, rates, strict=True)], trunk=1)
    np.testing.assert_allclose(found, [wanted for _, wanted in rates], atol=1e-6)


@given(
    time_ns=st.integers(0, 10**12),
    step=st.integers(0, 2**32 - 1),
    digests=st.tuples(st.binary(max_size=40), st.binary(max_size=200)),
    seed=st.integers(0, 9),
    sizes=st.tuples(*[st.integers(0, 20)] * 3),
)
def test_a_policy_step_by_hand_is_what_protobuf_writes(time_ns, step, digests, seed, sizes):
    rng = np.random.default_rng(seed)
    numbers = [rng.normal(size=size) for size in sizes]
    action, applied, targets = (each.tolist() for each in numbers)
    message = PolicyStep(
        timestamp=stamp(time_ns), step=step, observation_digest=digests[0], action=action,
        applied=applied, targets=targets, state_digest=digests[1],
    )  # fmt: skip
    written = policy_step(
        time_ns,
        step=step,
        observation_digest=digests[0],
        state_digest=digests[1],
        numbers=numbers,
    )
    assert written == message.SerializeToString(deterministic=True)
