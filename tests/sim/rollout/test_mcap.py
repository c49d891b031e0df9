"""A trial's log, read back by the official reader and protobuf decoder."""

from collections import Counter
from dataclasses import replace
from io import BytesIO
from itertools import pairwise

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from PIL import Image
from tests.sim.sensors.prop_scene import write_scene

from nw_scenes.robots import get_robot
from nw_sim.rollout.library import Library
from nw_sim.rollout.trial import run_trial

STEPS = 100  # 2 s at 50 Hz


@pytest.fixture(scope="module")
def logged(tmp_path_factory, library):
    return tmp_path_factory.mktemp("log") / "trial.mcap", library


@pytest.fixture(scope="module")
def walk(logged, make_job):
    """Return the log of a trial in which the policy walks for two seconds, and its result."""
    path, library = logged
    job = make_job(mcap=path, record="all", attachments=(("suite.yaml", "nw-eval: 1\n"),))
    result = run_trial(job, library=library)
    assert (result.status, result.error_text, result.mcap_error) == ("ok", "", "")
    return path, result


def messages(path):
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return [
            (d.channel.topic, d.message.log_time, d.message.publish_time, d.decoded_message)
            for d in reader.iter_decoded_messages(log_time_order=False)
        ]


def test_every_topic_has_its_schema_and_its_number_of_messages(walk):
    path, result = walk
    assert result.steps == STEPS
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    schemas = {c.topic: summary.schemas[c.schema_id] for c in summary.channels.values()}
    parts = {shape.body for shape in get_robot("go1").visuals}
    bodies = {f"/points/robot/{body}": "foxglove.PointCloud" for body in parts}
    seen = ("proprio", "scandots", "last_output", "history")
    assert {topic: schema.name for topic, schema in schemas.items()} == {
        "/tf": "foxglove.FrameTransforms",
        "/robot/joints": "foxglove.JointStates",
        "/robot/odom": "foxglove.PoseInFrame",
        "/robot/twist": "nw.Twist",
        "/robot/command": "nw.Command",
        "/robot/path": "foxglove.PointCloud",
        **{f"/observation/{name}": "nw.Observation" for name in seen},
        "/scene": "foxglove.SceneUpdate",
        "/waypoints": "foxglove.SceneUpdate",
        "/points/place": "foxglove.PointCloud",
        "/points/trail": "foxglove.PointCloud",
        "/points/waypoints": "foxglove.PointCloud",
        **bodies,
        "/camera/ego": "foxglove.CompressedImage",
        "/camera/ego/calib": "foxglove.CameraCalibration",
        "/nw/policy": "nw.PolicyStep",
        "/nw/state": "nw.SimState",
        "/nw/event": "nw.Event",
        "/log": "foxglove.Log",
    }
    assert {schema.encoding for schema in schemas.values()} == {"protobuf"}
    counts = Counter(topic for topic, *_ in messages(path))
    reached = result.waypoints_reached
    assert reached > 0, "two seconds are enough for the first waypoint"
    assert counts == {
        "/tf": STEPS + 1,
        "/robot/joints": STEPS + 1,
        "/robot/odom": STEPS + 1,
        "/robot/twist": STEPS + 1,
        "/robot/command": STEPS,
        "/robot/path": STEPS / 25 + 1,
        **{f"/observation/{name}": STEPS for name in seen},
        "/scene": 1,
        "/waypoints": 1 + reached,
        "/points/place": 1,
        "/points/trail": 1 + reached,
        "/points/waypoints": 1 + reached,
        **dict.fromkeys(bodies, 1),
        "/camera/ego": STEPS / 5,
        "/camera/ego/calib": 1,
        "/nw/policy": STEPS,
        "/nw/state": counts["/nw/state"],
        "/nw/event": 2 + reached,
        "/log": 2 + reached,
    }
    # 5 Hz and the end; one more after each waypoint that falls between two of those.
    assert STEPS / 10 + 1 <= counts["/nw/state"] <= STEPS / 10 + 1 + reached


def test_times_are_simulated_seconds_and_never_decrease(walk):
    path, result = walk
    times = [time for _, time, *_ in messages(path)]
    assert times == sorted(times)
    assert times[0] == 0
    assert times[-1] == round(result.sim_seconds * 1e9) == 2_000_000_000
    assert all(time == published for _, time, published, _ in messages(path))


def test_the_same_trial_gives_the_same_bytes(walk, make_job, library, tmp_path):
    path, _ = walk
    again = tmp_path / "again.mcap"
    job = make_job(mcap=again, record="all", attachments=(("suite.yaml", "nw-eval: 1\n"),))
    run_trial(job, library=library)
    assert again.read_bytes() == path.read_bytes()


def test_transforms_joints_and_pose_agree_with_each_other(walk):
    path, _ = walk
    last = {topic: message for topic, _, _, message in messages(path)}
    frames = {t.child_frame_id: t for t in last["/tf"].transforms}
    assert {"trunk", "FR_hip", "RL_calf", "camera/ego"} <= set(frames)
    assert {t.parent_frame_id for t in frames.values()} == {"world"}
    assert frames["trunk"].translation.x == last["/robot/odom"].pose.position.x > 0.5
    # The camera sits in front of the trunk's origin and looks ahead: OpenCV's z axis is forward.
    camera = frames["camera/ego"]
    assert 0.2 < camera.translation.x - frames["trunk"].translation.x < 0.4
    w, x, y, z = (getattr(camera.rotation, axis) for axis in "wxyz")
    forward = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
    assert forward[0] > 0.8
    names = [joint.name for joint in last["/robot/joints"].joints]
    assert len(names) == 12
    assert names[:3] == ["FR_hip_joint", "FR_thigh_joint", "FR_calf_joint"]


def test_a_reached_waypoint_turns_green_and_is_an_event(walk):
    path, result = walk
    read = messages(path)
    [scene] = [message for topic, _, _, message in read if topic == "/scene"]
    at_start = {entity.id: entity for entity in scene.entities}
    assert {"place/ground", "robot/trunk", "robot/FR_calf", "trail"} <= set(at_start)
    assert at_start["robot/trunk"].frame_id == "trunk"
    updates = [message for topic, _, _, message in read if topic == "/waypoints"]
    # Each message says all: a viewer whose time is moved looks at the latest one only.
    assert [[entity.id for entity in update.entities] for update in updates] == [
        ["waypoint/0", "waypoint/1"]
    ] * (1 + result.waypoints_reached)
    colours = [[entity.cylinders[0].color for entity in update.entities] for update in updates]
    assert all(colour.r > colour.g for colour in colours[0])
    assert [colour.g > colour.r for colour in colours[1]] == [True, False]
    events = [message for topic, _, _, message in messages(path) if topic == "/nw/event"]
    assert [event.kind for event in events] == [
        "start",
        *["waypoint"] * result.waypoints_reached,
        "end",
    ]
    assert events[1].waypoint == 0
    assert events[1].step * 0.02 == pytest.approx(result.waypoint_times[0])


def test_policy_steps_say_what_was_computed_and_what_was_applied_one_step_later(walk):
    path, _ = walk
    steps = [message for topic, _, _, message in messages(path) if topic == "/nw/policy"]
    assert [message.step for message in steps] == list(range(STEPS))
    assert list(steps[0].applied) == [0.0] * 12
    for earlier, later in pairwise(steps):
        assert list(later.applied) == list(earlier.action)
    assert len(steps[0].observation_digest) == 32


def test_pictures_are_jpegs_of_the_calibrated_size_with_something_to_see(walk):
    path, _ = walk
    read = messages(path)
    [calibration] = [message for topic, _, _, message in read if topic == "/camera/ego/calib"]
    frames = [message for topic, _, _, message in read if topic == "/camera/ego"]
    image = np.asarray(Image.open(BytesIO(frames[0].data)))
    assert frames[0].format == "jpeg"
    assert image.shape == (calibration.height, calibration.width, 3) == (90, 160, 3)
    assert image.std() > 10
    # The published camera: 90 degrees from top to bottom.
    assert calibration.K[0] == pytest.approx(45.0)


def test_metadata_and_attachments_tell_the_trial_and_its_verdict(walk):
    path, result = walk
    with path.open("rb") as stream:
        reader = make_reader(stream)
        records = {record.name: record.metadata for record in reader.iter_metadata()}
        attached = {record.name: record.data for record in reader.iter_attachments()}
    assert set(records) == {"nw.trial", "nw.provenance", "nw.elements", "nw.verdict"}
    assert records["nw.verdict"]["state_digest"] == result.state_digest
    assert records["nw.trial"]["scene"] == "flat/carpet_room"
    assert records["nw.provenance"]["mujoco"].startswith("4.")
    assert attached == {"suite.yaml": b"nw-eval: 1\n"}


def test_images_of_a_failure_are_kept_and_those_of_a_success_are_not(make_job, library, tmp_path):
    failure, success = tmp_path / "failure.mcap", tmp_path / "success.mcap"
    failed = run_trial(make_job(mcap=failure, record="failures", duration=0.5), library=library)
    passed = run_trial(make_job(mcap=success, record="failures", duration=12.0), library=library)
    assert (failed.outcome, passed.outcome) == ("timeout", "completed")
    kept = [topic for topic, *_ in messages(failure)].count("/camera/ego")
    dropped = [topic for topic, *_ in messages(success)].count("/camera/ego")
    assert (kept, dropped) == (5, 0)
    assert passed.wall.render == 0.0, "nothing is rendered that nobody will look at"
    times = [time for _, time, *_ in messages(failure)]
    assert times == sorted(times)


def test_a_summary_is_small_and_its_trial_has_the_same_result(make_job, library, tmp_path):
    whole, brief = tmp_path / "whole.mcap", tmp_path / "brief.mcap"
    one = run_trial(make_job(mcap=whole, record="none", duration=4.0), library=library)
    two = run_trial(make_job(mcap=brief, record="summary", duration=4.0), library=library)
    assert (one.state_digest, one.action_digest) == (two.state_digest, two.action_digest)
    assert brief.stat().st_size < 30_000 < whole.stat().st_size / 5
    said = {topic: [m for other, *_, m in messages(brief) if other == topic] for topic in TOLD}
    assert {topic for topic, *_ in messages(brief)} == {*TOLD, "/points/trail", "/points/waypoints"}
    assert {entity.id for entity in said["/scene"][0].entities} >= {"robot/trunk", "trail"}
    assert not any("place" in entity.id for entity in said["/scene"][0].entities)
    (walked, *_), last = said["/robot/path"], said["/robot/path"][-1]
    assert len(walked.data) < len(last.data)
    assert [line.kind for line in said["/nw/event"]][-1] == "end"


def test_props_are_in_frames_shapes_and_pictures_of_a_log(make_job, tmp_path):
    library = Library()
    scene = library.scene(str(write_scene(tmp_path / "yard")))
    path = tmp_path / "props.mcap"
    job = make_job(
        policy="stand", scene=str(tmp_path / "yard"), mcap=path, record="all", duration=0.4
    )
    named = {"scene": scene.name, "scene_digest": scene.digest, "task": scene.task}
    run_trial(replace(job, trial=replace(job.trial, **named)), library=library)
    said = messages(path)
    frames = {each.child_frame_id: each for each in said_first(said, "/tf").transforms}
    assert frames["prop/crate"].translation.z == pytest.approx(0.15, abs=1e-3)
    assert frames["prop/door"].rotation.w == 1.0
    shapes = {entity.id: entity for entity in said_first(said, "/scene").entities}
    assert shapes["prop/door"].frame_id == "prop/door"
    assert len(shapes["prop/crate"].triangles[0].indices) == 36
    picture = np.asarray(Image.open(BytesIO(said_first(said, "/camera/ego").data))).astype(int)
    blue = picture[..., 2] - picture[..., 0]
    assert (blue > 60).sum() > 100, "the door is blue"


def said_first(said, topic):
    return next(message for other, *_, message in said if other == topic)


TOLD = ("/scene", "/waypoints", "/robot/path", "/nw/event", "/log")


def test_a_policy_with_eyes_has_its_own_images_logged_at_their_rate(
    make_job, library, seeing, tmp_path
):
    path = tmp_path / "seen.mcap"
    result = run_trial(
        make_job(policy=seeing, mcap=path, record="all", duration=1.0), library=library
    )
    frames = [(time, m) for topic, time, _, m in messages(path) if topic == "/camera/ego"]
    # Samples at 0, 0.1, ..., each 0.04 s old when it is first seen; the very first one is not.
    assert [time for time, _ in frames] == [0, *(140_000_000 + k * 100_000_000 for k in range(9))]
    assert np.asarray(Image.open(BytesIO(frames[0][1].data))).shape == (24, 40, 3)
    assert 0.0 < result.coverage_min <= result.coverage_mean <= 1.0


def test_without_a_path_nothing_is_written_and_the_result_is_the_same(walk, make_job, library):
    _, logged_result = walk
    result = run_trial(make_job(), library=library)
    assert result.mcap_bytes == 0
    assert result.state_digest == logged_result.state_digest
    assert result.wall.log < 0.01
