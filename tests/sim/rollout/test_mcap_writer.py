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

from nw_sim.rollout.mcap.batch import BLANK_TIME, Form, filled, long_times, merged, record, records
from nw_sim.rollout.mcap.file import CHUNK_BYTES, McapWriter
from nw_sim.rollout.mcap.images import observation_form, values_of
from nw_sim.rollout.mcap.messages import (
    Observation,
    PolicyStep,
    Saved,
    SimState,
    StatePart,
    sim_state,
    stamp,
)
from nw_sim.rollout.mcap.steps import (
    BodyForms,
    joints_form,
    mounted_poses,
    odom_form,
    policy_steps,
    transforms_form,
    trunk_rates,
)

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


def filled_rows(form, times, numbers):
    """Return the bytes of a form's message for each time and row of numbers."""
    rows = np.empty((len(times), len(form)), np.uint8)
    form.fill(rows, long_times(np.array(times)), numbers)
    return [row.tobytes() for row in rows]


def filled_once(form, time_ns, numbers):
    return filled_rows(form, [time_ns], numbers[np.newaxis])[0]


@pytest.mark.parametrize("time_ns", TIMES)
def test_a_filled_form_reads_as_the_message_that_it_stands_for(time_ns):
    numbers = np.random.default_rng(1).normal(size=7)
    numbers[2] = 0.0
    form = odom_form()
    rows = np.stack([np.ones(7), numbers, np.zeros(7)])
    read = PoseInFrame.FromString(filled_rows(form, [5, time_ns, 0], rows)[1])
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
    read = joints.kind.FromString(filled_once(joints, 0, np.array([0.5, 1, 2, 3, 4, 5])))
    assert [(j.name, j.effort) for j in read.joints] == [("hip", 2.0), ("knee", 5.0)]
    assert (read.joints[0].position, read.joints[1].velocity) == (0.5, 4.0)


def test_records_of_messages_that_come_together_are_those_of_each_alone():
    forms = odom_form(), joints_form(("hip",))
    numbers = np.arange(14.0).reshape(2, 7), np.arange(6.0).reshape(2, 3)
    batch = filled([3, 7], forms, np.array(TIMES[1:3]), numbers)
    for number, time_ns in enumerate(TIMES[1:3]):
        alone = [
            record(channel, time_ns, filled_once(form, time_ns, rows[number]))
            for channel, form, rows in zip((3, 7), forms, numbers, strict=True)
        ]
        assert batch.pieces[number] == b"".join(alone)
        assert batch.places[2 * number :][:2].tolist() == [
            [3, time_ns, number, 0],
            [7, time_ns, number, len(alone[0])],
        ]


def test_merged_records_are_found_where_the_index_says():
    rng = np.random.default_rng(5)
    parts, expected = [], []
    for places in ((0, 2, 3), (), (3,), (2, 0)):
        data = [rng.bytes(int(size)) for size in rng.integers(0, 9, len(places))]
        channels, times = rng.integers(1, 99, (2, len(places))).tolist()
        parts.append((places, records(channels, times, data)))
        expected += zip(places, channels, times, data, strict=True)
    pieces, index = merged(5, parts)
    found = [
        (number, channel, time, pieces[number][start : start + len(record(channel, time, data))])
        for (channel, time, number, start), (*_, data) in zip(
            index.tolist(), sorted(expected, key=lambda each: each[0]), strict=True
        )
    ]
    assert found == [
        (number, channel, time, record(channel, time, data))
        for number, channel, time, data in sorted(expected, key=lambda each: each[0])
    ]
    assert pieces[1] == pieces[4] == b""


def test_a_row_of_the_body_becomes_the_numbers_of_its_four_messages():
    mount = np.array([0.3, 0, 0, 1, 0, 0, 0])
    body = BodyForms(
        names=("trunk", "leg"),
        bodies=(2, 1),
        in_model=3,
        joints=("hip", "knee"),
        cameras={"eye": mount},
    )
    # A model of three bodies, of which the first one is the world; nothing is turned.
    poses = np.arange(9.0), np.tile([1.0, 0, 0, 0], 3)
    row = np.concatenate((*poses, [0.1, 3, 1, 4], np.arange(10.0, 16.0), [2, 5]))
    assert len(row) == body.width
    filled_in = zip(body.forms.values(), body.numbers(row[np.newaxis]), strict=True)
    tf, joints, odom, twist = (
        form.kind.FromString(filled_once(form, 20, numbers[0])) for form, numbers in filled_in
    )
    assert [(t.child_frame_id, t.translation.x) for t in tf.transforms] == [
        ("trunk", 6.0),
        ("leg", 3.0),
        ("eye", np.float32(6.3)),
    ]
    assert [(j.position, j.velocity, j.effort) for j in joints.joints] == [
        (np.float32(0.1), 1.0, 2.0),
        (3.0, 4.0, 5.0),
    ]
    assert (odom.pose.position.y, odom.pose.orientation.w) == (7.0, 1.0)
    assert (twist.linear.x, twist.angular.z) == (10.0, 15.0)


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
    data, trunk, expected, rates = mujoco.MjData(model), [], [], []
    for _ in range(5):
        data.qpos[:], data.qvel[:] = rng.normal(size=7), rng.normal(size=6)
        mujoco.mj_forward(model, data)
        trunk.append(np.concatenate([data.xpos[1], data.xquat[1]]))
        expected.append(np.concatenate([data.xpos[2], data.xmat[2]]))
        turned = data.xmat[1].reshape(3, 3).T @ data.qvel[:3]
        rates.append((data.qvel.copy(), np.concatenate([turned, data.qvel[3:]])))
    camera = np.concatenate([model.body_pos[2], model.body_quat[2]])
    rows = mounted_poses(np.array(trunk), [camera])
    assert rows.shape == (5, 1, 7)
    for row, wanted in zip(rows[:, 0], expected, strict=True):
        matrix = np.empty(9)
        mujoco.mju_quat2Mat(matrix, row[3:].copy())
        np.testing.assert_allclose(np.concatenate([row[:3], matrix]), wanted, atol=1e-6)
    found = trunk_rates(np.array(trunk), np.array([velocity for velocity, _ in rates]))
    np.testing.assert_allclose(found, [wanted for _, wanted in rates], atol=1e-6)


@given(
    time_ns=st.integers(0, 10**12),
    step=st.integers(0, 2**32 - 1),
    digests=st.tuples(st.binary(max_size=40), st.binary(max_size=200)),
    seed=st.integers(0, 9),
    size=st.integers(0, 20),
)
def test_a_policy_step_by_hand_is_what_protobuf_writes(time_ns, step, digests, seed, size):
    rng = np.random.default_rng(seed)
    action, applied, targets = numbers = rng.normal(size=(3, size))
    message = PolicyStep(
        timestamp=stamp(time_ns), step=step, observation_digest=digests[0], action=action.tolist(),
        applied=applied.tolist(), targets=targets.tolist(), state_digest=digests[1],
    )  # fmt: skip
    _, written = policy_steps(
        [0, time_ns],
        [7, step],
        observations=[b"", digests[0]],
        states=[b"", digests[1]],
        numbers=np.stack([rng.normal(size=3 * size), numbers.ravel()]),
    )
    assert written == message.SerializeToString(deterministic=True)


@given(
    step=st.integers(0, 2**32 - 1),
    world=st.binary(max_size=400),
    policy=st.binary(max_size=3),
    parts=st.dictionaries(st.text(max_size=4), st.binary(max_size=200), max_size=3),
)
def test_a_state_by_hand_is_what_protobuf_writes(step, world, policy, parts):
    listed = [StatePart(name=name, data=data) for name, data in parts.items()]
    message = SimState(step=step, world=world, policy=policy, parts=listed)
    written = sim_state(Saved(step, world, policy, parts))
    assert written == message.SerializeToString(deterministic=True)
