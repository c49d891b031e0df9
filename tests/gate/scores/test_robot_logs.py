"""Robots' logs that mislead: their clocks, frames and sensors, and files of other kinds.

Each log is a robot of known motion. What is right is known by hand: every joint turns at 1 rad/s
with 2 N m, or moves as a sine, and the trunk goes 0.5 m/s.
"""

from __future__ import annotations

import gzip
import json
import math
import os
import sqlite3
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import lz4.frame
import numpy as np
import pytest
import zstandard
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as Plain
from mcap_protobuf.writer import Writer as Protobuf
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer
from ros_kinds import KINDS, PARTS

import nw_eval
from nw_base.errors import StoreError, UsageError
from nw_scenes.robots import get_robot
from nw_sim.rollout.replaying.log_clock import common, stretches
from nw_sim.rollout.replaying.log_messages import (
    FIELDS,
    NOTED,
    USED,
    frames_of,
    noted_in,
    stamp_of,
    values_of,
)

ASSETS = Path(os.environ.get("NW_EVAL_ASSETS", Path(__file__).parents[4] / "shared" / "assets"))
GO1 = get_robot("go1")
STAND = list(GO1.default_pose)
JOINT, ODOM, POSE, IMU, TWIST, STAMPED, ARRAY, TF = KINDS
EPOCH = 1.7e9
SECONDS, HZ = 4.0, 100
TIMES = np.arange(int(SECONDS * HZ)) / HZ


def vector(x=0.0, y=0.0, z=0.0):
    return {"x": float(x), "y": float(y), "z": float(z)}


def turn(roll=0.0, pitch=0.0, yaw=0.0):
    """Return a quaternion, turned by yaw, then pitch, then roll."""
    (a, b, c), (d, e, f) = (
        [op(angle / 2) for angle in (roll, pitch, yaw)] for op in (math.cos, math.sin)
    )
    return {
        "w": a * b * c + d * e * f,
        "x": d * b * c - a * e * f,
        "y": a * e * c + d * b * f,
        "z": a * b * f - d * e * c,
    }


def header(stamp, frame=""):
    sec, nanosec = divmod(round((stamp or 0.0) * 1e9), 10**9)
    return {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": frame}


def joints(stamp=None, *, rate=1.0, effort=2.0, names=GO1.joints, position=None):
    """Return a message; the joints go to and fro so that positions and rates agree."""
    count = len(names)
    return {
        "header": header(stamp),
        "name": list(names),
        "position": (STAND * 2)[:count] if position is None else position,
        "velocity": list(rate) if isinstance(rate, (list, tuple)) else [rate] * count,
        "effort": list(effort) if isinstance(effort, (list, tuple)) else [effort] * count,
    }


def odometry(stamp=None, **how):
    facing = turn(how.get("roll", 0.0), 0.0, how.get("yaw", 0.0))
    covariance = [float(how.get("known", 0.0)), *[0.0] * 35]
    pose = {
        "position": vector(*how.get("place", (0, 0, 0.3))),
        "orientation": how.get("orientation", facing),
    }
    moving = {"linear": vector(*how.get("twist", (0.5, 0, 0))), "angular": vector()}
    return {
        "header": header(stamp, how.get("frame", "odom")),
        "child_frame_id": how.get("child", "base_link"),
        "pose": {"pose": pose, "covariance": covariance},
        "twist": {"twist": moving, "covariance": covariance},
    }


def imu(stamp=None, *, orientation=None, known=0.0, force=(0, 0, 9.8), turning=(0, 0, 0)):
    return {
        "header": header(stamp, "imu"),
        "orientation": orientation or turn(),
        "orientation_covariance": [known, *[0.0] * 8],
        "angular_velocity": vector(*turning),
        "angular_velocity_covariance": [0.0] * 9,
        "linear_acceleration": vector(*force),
        "linear_acceleration_covariance": [0.0] * 9,
    }


def twist(x=0.5, turning=0.0):
    return {"linear": vector(x), "angular": vector(0, 0, turning)}


def write(path, entries, **options):
    """Write (logged s, topic, kind, message) in this order."""
    with path.open("wb") as stream:
        writer = Writer(stream, **options)
        schemas = {}
        for logged, topic, kind, message in entries:
            if kind not in schemas:
                schemas[kind] = writer.register_msgdef(kind, KINDS[kind] + PARTS)
            ns = round(logged * 1e9)
            writer.write_message(topic, schemas[kind], message, log_time=ns, publish_time=ns)
        writer.finish()
    return path


def scores(path, **more):
    return nw_eval.log_scores(path, robot="go1", **more)


def sine(logged, *, stamped=True):
    """Return joints of a sine of 1 Hz, which give 2 N m * 12 / pi = 7.64 W in the mean."""
    rates = np.sin(2 * np.pi * TIMES)
    return [
        (at, "/joint_states", JOINT, joints(EPOCH + time if stamped else None, rate=rate))
        for at, time, rate in zip(logged, TIMES, rates.tolist(), strict=True)
    ]


SINE = 24.0 / math.pi
BURSTS = EPOCH + np.floor(TIMES * 2) / 2 + 0.5 + (np.arange(len(TIMES)) % 50) * 1e-4


def told(found, *words):
    return [note for note in found.notes if all(word in note for word in words)]


# Clocks.


def test_log_times_in_bursts_give_way_to_header_stamps(tmp_path):
    found = scores(write(tmp_path / "log.mcap", sine(BURSTS)))
    assert found.values["mean_power"] == pytest.approx(SINE, rel=0.01)
    assert told(found, "/joint_states", "come in bursts", "header stamps are used")


def test_targets_without_stamps_are_put_on_the_clock_of_joints(tmp_path):
    targets = [
        (
            at + 5e-5,
            "/joint_command",
            ARRAY,
            {
                "layout": {"dim": [], "data_offset": 0},
                "data": list(np.array(STAND) + 0.1 * math.sin(2 * math.pi * time)),
            },
        )
        for at, time in zip(BURSTS, TIMES, strict=True)
    ]
    entries = sorted([*sine(BURSTS), *targets], key=lambda entry: entry[0])
    found = scores(write(tmp_path / "log.mcap", entries))
    # 0.1 rad at 2 pi rad/s: the root mean square of its rate is 0.1 * 2 pi / sqrt 2.
    assert found.values["action_rate"] == pytest.approx(0.1 * 2 * math.pi / math.sqrt(2), rel=0.02)


@pytest.mark.parametrize(
    ("logged", "words"),
    [
        (BURSTS, "come in bursts"),
        (EPOCH + np.where(TIMES < 2.0, TIMES, TIMES - 1.0), "go back by 0.99 s after message 200"),
        (1000 + TIMES * 1e-6, r"are 1\S*e-08 s apart"),
        (EPOCH + np.floor(TIMES), "repeat"),
    ],
)
def test_log_times_alone_that_cannot_be_right_are_refused(tmp_path, logged, words):
    path = write(tmp_path / "log.mcap", sine(logged, stamped=False))
    with pytest.raises(UsageError, match=f"header stamps are missing, and its log times {words}"):
        scores(path)


@pytest.mark.parametrize(
    "logged",
    [
        EPOCH + np.where(TIMES < 2.0, TIMES, TIMES - 1.0),
        EPOCH + TIMES * 1e-6,
        EPOCH + np.floor(TIMES),
        EPOCH - TIMES,
        EPOCH + 4 * TIMES,
    ],
    ids=["set back", "microseconds", "whole seconds", "backwards", "a slow simulator"],
)
def test_header_stamps_are_used_whatever_was_logged(tmp_path, logged):
    found = scores(write(tmp_path / "log.mcap", sine(logged)))
    assert found.values["mean_power"] == pytest.approx(SINE, rel=0.01)
    assert found.seconds == pytest.approx(3.98)
    assert told(found, "/joint_states", "used")


@pytest.mark.parametrize(
    ("stamps", "word"),
    [
        (EPOCH + np.where(TIMES < 2.0, TIMES, TIMES - 1.0), "go back"),
        (np.full(len(TIMES), EPOCH), "repeat"),
        (EPOCH / 100 + 1000 * TIMES, "are 10 s apart"),
        (0.0 * TIMES, ""),
    ],
    ids=["set back", "constant", "milliseconds", "zero"],
)
def test_header_stamps_that_cannot_be_right_give_way_to_log_times(tmp_path, stamps, word):
    entries = [
        (at, topic, kind, {**message, "header": header(stamp)})
        for (at, topic, kind, message), stamp in zip(sine(EPOCH + TIMES), stamps, strict=True)
    ]
    found = scores(write(tmp_path / "log.mcap", entries))
    assert found.values["mean_power"] == pytest.approx(SINE, rel=0.01)
    assert bool(told(found, word, "log times are used")) == bool(word)


def test_a_clock_set_back_in_both_times_is_refused(tmp_path):
    entries = [
        (at, topic, kind, {**message, "header": header(at)})
        for at, topic, kind, message in sine(EPOCH + np.where(TIMES < 2.0, TIMES, TIMES - 1.0))
    ]
    with pytest.raises(
        UsageError, match=r"stamps go back by 0\.99 s .*cut the log where its clock"
    ):
        scores(write(tmp_path / "log.mcap", entries))


def test_stamps_of_a_simulation_and_of_a_wall_clock_are_put_on_one(tmp_path):
    entries = []
    for time in TIMES.tolist():
        rate = 1.0 if time < 2.0 else 0.0
        entries.append((EPOCH + time, "/joint_states", JOINT, joints(time + 1.0, rate=rate)))
        place = (0.5 * min(time, 2.0), 0, 0.3)
        moving = (0.5 if time < 2.0 else 0.0, 0, 0)
        told_ = odometry(EPOCH + time, place=place, twist=moving, roll=0.1 * math.sin(time))
        entries.append((EPOCH + time, "/odom", ODOM, told_))
    found = scores(write(tmp_path / "log.mcap", entries))
    assert found.values["distance_before_fall"] == pytest.approx(1.0, abs=0.02)
    assert told(found, "header stamps of /odom", "another clock than those of /joint_states")


def test_messages_that_were_recorded_twice_count_once(tmp_path):
    entries = [entry for entry in sine(EPOCH + TIMES) for _ in range(2)]
    found = scores(write(tmp_path / "log.mcap", entries))
    assert found.values["mean_power"] == pytest.approx(SINE, rel=0.01)
    assert told(found, "are there twice")


def test_two_robots_on_one_topic_are_refused(tmp_path):
    both = [
        (at + late, "/joint_states", JOINT, joints(at, rate=rate))
        for at in (EPOCH + TIMES).tolist()
        for late, rate in ((0.0, 1.0), (1e-5, -3.0))
    ]
    with pytest.raises(UsageError, match="stamps repeat, and its log times come in bursts"):
        scores(write(tmp_path / "log.mcap", both))


def test_one_message_at_time_zero_is_left_out(tmp_path):
    path = write(tmp_path / "log.mcap", [
        (0.0, "/odom", ODOM, odometry(roll=0.1)),
        *((EPOCH + t, "/odom", ODOM, odometry(EPOCH + t, place=(0.5 * t, 0, 0), roll=0.1 * t))
          for t in TIMES.tolist()),
    ])  # fmt: skip
    found = scores(path)
    assert found.seconds == pytest.approx(3.98)
    assert found.values["distance_before_fall"] == pytest.approx(1.98, abs=0.02)
    assert told(found, "1 ", "/odom", "left out")


def test_a_pause_is_not_scored(tmp_path):
    late = EPOCH + TIMES + np.where(TIMES < 2.0, 0.0, 10.0)
    entries = []
    for at, time in zip(late.tolist(), TIMES.tolist(), strict=True):
        entries += [
            (at, "/joint_states", JOINT, joints(at)),
            (
                at,
                "/joint_command",
                JOINT,
                joints(at, position=[STAND[0] + (time > 2.0), *STAND[1:]]),
            ),
            (at, "/odom", ODOM, odometry(at, place=(0.5 * time, 0, 0.3), roll=0.1 * time)),
        ]
    found = scores(write(tmp_path / "log.mcap", entries))
    assert found.values["mean_power"] == pytest.approx(24.0)
    assert found.seconds == pytest.approx(3.96)
    assert found.values["action_rate"] == 0.0  # The step is in the pause.
    assert "pause" in found.missing["distance_before_fall"]
    assert told(found, "10.02 s in 1 pause")


def test_stretches_and_what_they_share():
    times = np.concatenate([[0.0], 5 + np.arange(11) / 10, 20 + np.arange(6) / 10])
    spans, rate, alone = stretches(times)
    assert spans == [(5.0, 6.0), (20.0, 20.5)]
    assert (rate, alone) == (pytest.approx(10.0), 1)
    assert common([spans, [(5.5, 20.2), (20.3, 30.0)]]) == [(5.5, 6.0), (20.0, 20.2), (20.3, 20.5)]


# Poses.


def poses(tmp_path, how, *, command=True):
    entries = [(EPOCH, "/cmd_vel", TWIST, twist())] if command else []
    for time in TIMES.tolist():
        entries += [(EPOCH + time, *each) for each in how(time)]
    return scores(write(tmp_path / "log.mcap", entries))


@pytest.mark.parametrize("child", ["odom", "base_link"])
def test_a_twist_in_the_frame_of_the_world_is_noticed(tmp_path, child):
    def walk(time):
        place, roll = (0.5 * time, 0, 0.3), 0.01 * math.sin(9 * time)
        yield (
            "/odom",
            ODOM,
            odometry(EPOCH + time, place=place, yaw=math.pi / 2, roll=roll, child=child),
        )

    found = poses(tmp_path, walk)
    if child == "odom":
        assert found.values["tracking_error_linear"] == pytest.approx(math.sqrt(0.5), rel=1e-3)
        assert told(found, "twist of /odom is in the frame 'odom'")
    else:
        assert (
            "0.707 m/s apart; it would agree in the frame 'odom'"
            in (found.missing["tracking_error_linear"])
        )
    assert found.values["distance_before_fall"] == pytest.approx(1.99, abs=0.02)


@pytest.mark.parametrize(
    ("moving", "scale", "missing"),
    [
        ((0, 0, 0), 1.0, "says 0 m/s, its positions 0.5 m/s"),
        ((0.5, 0, 0), 0.0, "says 0.5 m/s, its positions 0 m/s"),
        ((0.5, 0, 0), 1000.0, "no position|jump"),
        ((0, 0.5, 0), 1.0, "it would agree|apart"),
    ],
    ids=["no twist", "no positions", "mm", "a third frame"],
)
def test_a_twist_that_contradicts_the_positions_gives_no_score(tmp_path, moving, scale, missing):
    def walk(time):
        place = (0.5 * time * scale, 0, 0.3)
        yield "/odom", ODOM, odometry(EPOCH + time, place=place, twist=moving, roll=0.1 * time)

    found = poses(tmp_path, walk)
    if scale == 1000.0:
        assert "jump by" in found.missing["distance_before_fall"]
        return
    assert any(each in found.missing["tracking_error_linear"] for each in missing.split("|"))
    assert ("distance_before_fall" in found.values) == (scale == 1.0)


@pytest.mark.parametrize(("share", "noted"), [(1.0, False), (0.9, False), (0.7, True)])
def test_a_twist_that_differs_from_the_positions_is_scored_with_a_note(tmp_path, share, noted):
    def walk(time):
        place, twist = (0.5 * time, 0, 0.3), (0.5 * share, 0, 0)
        yield "/odom", ODOM, odometry(EPOCH + time, place=place, twist=twist, roll=0.1 * time)

    found = poses(tmp_path, walk)
    assert found.values["tracking_error_linear"] == pytest.approx(0.5 - 0.5 * share, abs=1e-3)
    assert bool(told(found, "which is right is not known")) == noted


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        ({"known": -1.0, "orientation": turn(0.1)}, "its covariance begins with -1"),
        ({"orientation": {"w": 0.0, "x": 0.0, "y": 0.0, "z": 0.0}}, "a quaternion of length 0"),
        (
            {"orientation": {"w": math.nan, "x": 0.0, "y": 0.0, "z": 0.0}},
            "a quaternion of length nan",
        ),
        ({}, "never change: they are not measured"),
        ({"orientation": turn(math.pi)}, "180 degrees from upright"),
    ],
    ids=["unknown", "zero", "nan", "constant", "upside down"],
)
def test_an_attitude_that_was_not_measured_gives_no_score(tmp_path, message, reason):
    found = poses(tmp_path, lambda time: [("/imu/data", IMU, imu(EPOCH + time, **message))])
    assert reason in found.missing["base_roll_rms"]
    assert reason in found.missing["base_pitch_rms"]


def test_an_attitude_is_compared_with_its_accelerometer(tmp_path):
    def lean(time):
        yield "/imu", IMU, imu(EPOCH + time, orientation=turn(0.01 * time), force=(4.9, 0, 8.5))

    assert "30 degrees off by the accelerometer" in poses(tmp_path, lean).missing["base_roll_rms"]


def test_odometry_of_a_plane_has_no_roll_and_names_the_imu(tmp_path):
    def walk(time):
        yield "/odom", ODOM, odometry(EPOCH + time, place=(0.5 * time, 0, 0.3))
        yield "/imu", IMU, imu(EPOCH + time, orientation=turn(0.2 * math.sin(7 * time)))

    found = poses(tmp_path, walk)
    assert "never change" in found.missing["base_roll_rms"]
    assert "--topic pose=/imu" in found.missing["base_roll_rms"]
    assert found.values["tracking_error_linear"] == pytest.approx(0.0, abs=1e-9)
    found = scores(tmp_path / "log.mcap", topics=["pose=/imu"])
    assert found.values["base_roll_rms"] == pytest.approx(0.2 / math.sqrt(2), rel=0.05)


@pytest.mark.parametrize(("offset", "swing"), [(0.3, 0.2), (0.0, -0.2), (0.0, 0.2)])
def test_two_attitudes_are_compared(tmp_path, offset, swing):
    def walk(time):
        roll = 0.2 * math.sin(7 * time)
        yield "/odom", ODOM, odometry(EPOCH + time, place=(0.5 * time, 0, 0.3), roll=roll)
        other = offset + swing * math.sin(7 * time)
        yield "/imu", IMU, imu(EPOCH + time, orientation=turn(other))

    found = poses(tmp_path, walk)
    assert bool(told(found, "one may be mounted turned")) == (offset > 0.0)
    assert ("base_roll_rms" in found.values) == (swing > 0.0)
    if swing < 0.0:
        assert "/odom and /imu are" in found.missing["base_roll_rms"]


def test_yaw_rates_that_contradict_the_attitude_give_no_score(tmp_path):
    def curve(time):
        place = (math.sin(0.5 * time), 1 - math.cos(0.5 * time), 0.3)
        how = {"place": place, "yaw": 0.5 * time, "roll": 0.1 * math.sin(9 * time)}
        yield "/odom", ODOM, odometry(EPOCH + time, **how)

    found = poses(tmp_path, curve)
    assert "yaw rates of /odom (0 rad/s) contradict" in found.missing["tracking_error_angular"]
    assert found.values["tracking_error_linear"] == pytest.approx(0.0, abs=1e-9)


def test_a_fall_ends_what_is_undefined_after_one(tmp_path):
    def walk(time):
        roll = 0.02 * math.sin(7 * time) + (1.4 if time > 3.0 else 0.0)
        yield "/odom", ODOM, odometry(EPOCH + time, place=(0.5 * time, 0, 0.3), roll=roll)

    found = poses(tmp_path, walk)
    for name in ("tracking_error_linear", "distance_before_fall"):
        assert "lies on its side at 3.01 s" in found.missing[name]


# Joints and targets.


def test_nan_efforts_leave_the_other_scores(tmp_path):
    entries = [
        (EPOCH + t, "/joint_states", JOINT, joints(EPOCH + t, effort=math.nan)) for t in TIMES
    ]
    entries += [
        (EPOCH + t, "/odom", ODOM, odometry(EPOCH + t, place=(0.5 * t, 0, 0), roll=0.1 * t))
        for t in TIMES.tolist()
    ]
    found = scores(write(tmp_path / "log.mcap", entries))
    assert found.missing["mean_power"] == "/joint_states has no torques: NaN or infinite numbers"
    assert found.values["distance_before_fall"] == pytest.approx(1.99, abs=0.02)


@pytest.mark.parametrize(
    ("message", "score", "reason"),
    [
        ({"effort": 0.0}, "mean_power", "efforts of 0 throughout"),
        ({"effort": [2.0] * 11 + [0.0]}, "mean_power", "efforts of RL_calf_joint of 0 throughout"),
        ({"effort": 900.0}, "mean_power", "times the limits of go1"),
        ({"position": [90.0] * 12}, "limit_time", "outside its range"),
        ({"position": [90.0] * 12}, "mean_power", "outside its range"),
        ({"effort": [2.0] * 11}, "mean_power", "11 numbers of effort for 12 joints"),
    ],
)
def test_joints_that_were_not_measured_in_these_units_give_no_score(
    tmp_path, message, score, reason
):
    entries = [(EPOCH + t, "/joint_states", JOINT, joints(EPOCH + t, **message)) for t in TIMES]
    entries += [(EPOCH + t, "/joint_command", JOINT, joints(EPOCH + t)) for t in TIMES]
    assert reason in scores(write(tmp_path / "log.mcap", entries)).missing[score]


@pytest.mark.parametrize("scale", [0.0, 180.0 / math.pi, -1.0], ids=["unset", "degrees", "sign"])
def test_velocities_that_moving_joints_contradict_give_no_power(tmp_path, scale):
    entries = []
    for time in TIMES.tolist():
        position = [angle + 0.2 * math.sin(2 * time) for angle in STAND]
        message = joints(EPOCH + time, rate=scale * 0.4 * math.cos(2 * time), position=position)
        entries.append((EPOCH + time, "/joint_states", JOINT, message))
    found = scores(write(tmp_path / "log.mcap", entries))
    assert "rad/s of all joints) contradict its positions" in found.missing["mean_power"]


def test_one_joint_without_velocities_gives_no_power(tmp_path):
    entries = []
    for time in TIMES.tolist():
        position = [angle + 0.1 * math.sin(12 * time) for angle in STAND]
        rates = [1.2 * math.cos(12 * time)] * 11 + [0.0]
        message = joints(EPOCH + time, rate=rates, position=position)
        entries.append((EPOCH + time, "/joint_states", JOINT, message))
    found = scores(write(tmp_path / "log.mcap", entries))
    assert "contradict its positions: ['RL_calf_joint']" in found.missing["mean_power"]


@pytest.mark.parametrize(("kind", "taken"), [("position", True), ("effort", False)])
def test_commands_of_efforts_are_no_targets_of_positions(tmp_path, kind, taken):
    topic = f"/{kind}_controller/commands"
    message = {"layout": {"dim": [], "data_offset": 0}, "data": STAND}
    entries = [
        entry
        for t in TIMES
        for entry in (
            (EPOCH + t, "/joint_states", JOINT, joints(EPOCH + t)),
            (EPOCH + t, topic, ARRAY, message),
        )
    ]
    found = scores(write(tmp_path / "log.mcap", entries))
    assert ("action_rate" in found.values) == taken
    assert taken or "not angles" in found.unused[topic]


@pytest.mark.parametrize(
    ("first", "last", "said"),
    [(3.0, 4.0, "begins 3 s late"), (0.0, 1.0, "says nothing for 2.9"), (0.0, 4.0, None)],
)
def test_how_long_a_command_is_held_is_said(tmp_path, first, last, said):
    def walk(time):
        yield "/odom", ODOM, odometry(EPOCH + time, place=(0.5 * time, 0, 0.3), roll=1e-3 * time)
        if first <= time <= last:
            yield "/cmd_vel", TWIST, twist()

    notes = poses(tmp_path, walk, command=False).notes
    assert [said is not None and said in note for note in notes if "/cmd_vel" in note] == (
        [True] if said else []
    )


@pytest.mark.parametrize(
    ("child", "noise", "said"),
    [("base_link", 1e-7, "never change"), ("base_link", 0.1, ""), ("camera_link", 0.1, "mounting")],
)
def test_a_roll_needs_a_pose_of_the_trunk_that_is_more_than_rounding(tmp_path, child, noise, said):
    def walk(time):
        how = {"place": (0.5 * time, 0, 0.3), "child": child, "roll": noise * math.sin(9 * time)}
        yield "/odom", ODOM, odometry(EPOCH + time, **how)

    found = poses(tmp_path, walk)
    assert ("base_roll_rms" in found.values) == (noise > 1e-3)
    told_all = " ".join([*found.notes, found.missing.get("base_roll_rms", "")])
    assert said in told_all
    assert ("mounting" in told_all) == (child == "camera_link")


def test_rates_and_signs_that_contradict_each_other_are_noted(tmp_path):
    entries = [
        (EPOCH + t, "/joint_states", JOINT, joints(EPOCH + t, rate=-5.0)) for t in TIMES.tolist()
    ]
    found = scores(write(tmp_path / "log.mcap", entries))
    assert told(found, "contradict its positions")
    assert told(found, "wrong sign")


def test_efforts_in_every_second_message_are_used_at_their_rate(tmp_path):
    entries = [
        (EPOCH + t, "/joint_states", JOINT, joints(EPOCH + t, effort=[] if n % 2 else 2.0))
        for n, t in enumerate(np.arange(800) / 200)
    ]
    found = scores(write(tmp_path / "log.mcap", entries))
    assert found.values["mean_power"] == pytest.approx(24.0)
    assert told(found, "/joint_states has no torques in 400 of 800 messages")


def test_messages_of_other_joints_are_left_out_and_counted(tmp_path):
    entries = []
    for number, time in enumerate((EPOCH + TIMES).tolist()):
        entries.append((time, "/joint_states", JOINT, joints(time)))
        if number % 2:
            entries.append(
                (time + 0.003, "/joint_states", JOINT, joints(time + 0.003, names=["gripper"]))
            )
    found = scores(write(tmp_path / "log.mcap", entries))
    assert found.values["mean_power"] == pytest.approx(24.0)
    assert told(found, "no joint 'FR_hip_joint' of go1", "200 of 600")


def test_a_joint_that_is_there_twice_is_refused(tmp_path):
    names = [*GO1.joints, *GO1.joints]
    entries = [(EPOCH + t, "/joint_states", JOINT, joints(EPOCH + t, names=names)) for t in TIMES]
    with pytest.raises(UsageError, match=r"has joint 'FR_hip_joint' 2 times in one message"):
        scores(write(tmp_path / "log.mcap", entries))


@pytest.mark.parametrize(
    ("topic", "source"),
    [
        ("/interaction/joint_states", "joints"),
        ("/retargeting/joint_states", "joints"),
        ("/preferences/joints", "joints"),
        ("/joint_commands", "targets"),
        ("/jointCmd", "targets"),
        ("/lowcmd", "targets"),
        ("/command/joints", "targets"),
        ("/desired_joint_states", "targets"),
        ("/action", "targets"),
    ],
)
def test_a_topics_whole_words_say_what_it_is(tmp_path, topic, source):
    entries = [(EPOCH + t, topic, JOINT, joints(EPOCH + t)) for t in TIMES]
    assert scores(write(tmp_path / "log.mcap", entries)).topics == {source: topic}


def test_a_topic_whose_name_says_both_is_named(tmp_path):
    entries = [(EPOCH + t, "/target/joint_states", JOINT, joints(EPOCH + t)) for t in TIMES]
    path = write(tmp_path / "log.mcap", entries)
    with pytest.raises(UsageError, match="--topic joints=/target/joint_states or targets="):
        scores(path)
    assert scores(path, topics=["joints=/target/joint_states"]).values["mean_power"] == 24.0


def test_a_measured_twist_and_a_goal_are_no_command_and_no_pose(tmp_path):
    goal = {"header": header(EPOCH), "pose": odometry()["pose"]["pose"]}
    entries = [(EPOCH, "/goal_pose", POSE, goal)]
    for time in (EPOCH + TIMES).tolist():
        entries.append((time, "/joint_states", JOINT, joints(time)))
        entries.append((time, "/base_velocity", TWIST, twist()))
        entries.append((time, "/tf", TF, {"nothing": 1}))
    found = scores(write(tmp_path / "log.mcap", entries))
    assert dict(found.topics) == {"joints": "/joint_states"}
    assert found.unused["/goal_pose"] == "its name means the robot's goal"
    assert found.unused["/base_velocity"] == "its name does not say a command"
    assert found.unused["/tf"] == "tf2_msgs/msg/TFMessage is not read"


def test_two_commands_are_ambiguous_whatever_their_kind(tmp_path):
    entries = [(EPOCH + t, "/joint_states", JOINT, joints(EPOCH + t)) for t in TIMES]
    stamped = {"header": header(None), "twist": twist(1.0)}
    entries += [(EPOCH, "/cmd_vel", TWIST, twist()), (EPOCH, "/cmd_vel_stamped", STAMPED, stamped)]
    with pytest.raises(UsageError, match="/cmd_vel and /cmd_vel_stamped could all be command"):
        scores(write(tmp_path / "log.mcap", entries))


def test_raw_actions_are_not_targets(tmp_path):
    none = {"dim": [], "data_offset": 0}
    entries = [(EPOCH + t, "/joint_states", JOINT, joints(EPOCH + t)) for t in TIMES]
    entries += [
        (EPOCH + t, "/action", ARRAY, {"layout": none, "data": [0.1 * t] * 12})
        for t in TIMES.tolist()
    ]
    missing = scores(write(tmp_path / "log.mcap", entries)).missing["action_rate"]
    assert "actions before scale and offset" in missing


def test_an_array_of_another_size_is_not_a_set_of_targets(tmp_path):
    entries = [(EPOCH + t, "/joint_states", JOINT, joints(EPOCH + t)) for t in TIMES]
    entries += [
        (EPOCH + t, "/action", ARRAY, {"layout": LAYOUT, "data": [0.0] * 13}) for t in TIMES
    ]
    path = write(tmp_path / "log.mcap", entries)
    assert "13 numbers for the 12 joints of go1" in scores(path).missing["action_rate"]
    with pytest.raises(UsageError, match="names one topic for two readings"):
        scores(path, topics=["joints=/joint_states", "targets=/joint_states"])


def test_unset_numbers_of_protobuf_are_not_zero(tmp_path):
    path = tmp_path / "log.mcap"
    with path.open("wb") as stream, Protobuf(stream) as writer:
        for time in (EPOCH + TIMES).tolist():
            message = JointStates()
            message.timestamp.FromNanoseconds(round(time * 1e9))
            for name, angle in zip(GO1.joints, STAND, strict=True):
                message.joints.add(name=name, position=angle, velocity=1.0)
            writer.write_message("/joint_states", message, round(time * 1e9), round(time * 1e9))
    assert "0 numbers of effort for 12 joints" in scores(path).missing["mean_power"]


# Files.


def plain_log(tmp_path):
    return write(tmp_path / "log.mcap", sine(EPOCH + TIMES))


FILES = {
    "a ROS 1 bag; convert it: `rosbags-convert": lambda path, _: path.write_bytes(
        b"#ROSBAG V2.0\n"
    ),
    "a Git LFS pointer": lambda path, _: path.write_text(
        "version https://git-lfs.github.com/spec/v1"
    ),
    "is empty": lambda path, _: path.write_bytes(b""),
    "no MCAP file: it begins with '{": lambda path, _: path.write_text('{"a": 1}'),
}


@pytest.mark.parametrize("words", FILES)
def test_a_log_in_another_form_is_named(tmp_path, words):
    other = tmp_path / "other.mcap"
    FILES[words](other, plain_log(tmp_path).read_bytes())
    with pytest.raises(UsageError, match=words):
        scores(other)


def test_a_cut_log_is_damaged(tmp_path):
    path = plain_log(tmp_path)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(StoreError, match="mcap recover"):
        scores(path)


def test_the_folder_of_a_bag_is_its_one_file(tmp_path):
    folder = tmp_path / "bag"
    folder.mkdir()
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information:\n")
    with pytest.raises(UsageError, match=r"is a folder with no MCAP file and no \.db3"):
        scores(folder)
    plain_log(folder)
    assert scores(folder).values["mean_power"] == pytest.approx(SINE, rel=0.01)
    write(folder / "more.mcap", sine(EPOCH + TIMES))
    with pytest.raises(UsageError, match=r"is a folder with log\.mcap, more\.mcap; name one"):
        scores(folder)


@pytest.mark.parametrize("compression", CompressionType)
def test_chunks_are_read_however_they_are_compressed(tmp_path, compression):
    path = write(tmp_path / "log.mcap", sine(EPOCH + TIMES), compression=compression)
    assert scores(path).values["mean_power"] == pytest.approx(SINE, rel=0.01)


PACKERS = {"zstd": zstandard.compress, "gz": gzip.compress, "lz4": lz4.frame.compress}


@pytest.mark.parametrize("name", PACKERS)
def test_a_log_that_is_compressed_as_a_whole_is_read(tmp_path, name):
    log = plain_log(tmp_path)
    packed = tmp_path / f"log.mcap.{name}"
    packed.write_bytes(PACKERS[name](log.read_bytes()))
    found = scores(packed)
    assert found.values == scores(log).values
    assert found.log == packed


# Bags of rosbag2's storage `sqlite3`.


def as_bag(log, path, *, part=slice(None), definitions=False):
    """Write messages of an MCAP file as `ros2 bag record -s sqlite3` lays them out."""
    with log.open("rb") as stream:
        messages = list(make_reader(stream).iter_messages())
    with closing(sqlite3.connect(path)) as bag, bag:
        bag.execute(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,"
            "serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL)"
        )
        bag.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,"
            "timestamp INTEGER NOT NULL, data BLOB NOT NULL)"
        )
        kinds = {channel.topic: schema for schema, channel, _ in messages}
        topics = list(kinds)
        for number, topic in enumerate(topics, 1):
            row = (number, topic, kinds[topic].name, "cdr", "")
            bag.execute("INSERT INTO topics VALUES(?, ?, ?, ?, ?)", row)
        if definitions:
            bag.execute(
                "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT,"
                "encoding TEXT, encoded_message_definition TEXT, type_description_hash TEXT)"
            )
            for number, schema in enumerate(kinds.values()):
                row = (number, schema.name, "ros2msg", schema.data.decode(), "")
                bag.execute("INSERT INTO message_definitions VALUES(?, ?, ?, ?, ?)", row)
        for _, channel, message in messages[part]:
            row = (topics.index(channel.topic) + 1, message.log_time, message.data)
            bag.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)", row)
    return path


def walking_log(tmp_path):
    """Every kind of message that a definition is known of here, but Unitree's."""
    times = (EPOCH + TIMES).tolist()
    entries = sine(times)
    entries += [
        (time, "/odom", ODOM, odometry(time, place=(0.5 * (time - EPOCH), 0.0, 0.3)))
        for time in times
    ]
    entries += [(time, "/imu", IMU, imu(time)) for time in times]
    entries += [
        (time, "/cmd_vel", STAMPED, {"header": header(time), "twist": twist()}) for time in times
    ]
    entries += [
        (time, "/action_target", ARRAY, {"layout": LAYOUT, "data": STAND}) for time in times
    ]
    return write(tmp_path / "walk.mcap", entries)


@pytest.mark.parametrize("definitions", [False, True])
def test_a_bag_has_the_scores_of_the_same_messages_in_mcap(tmp_path, definitions):
    log = walking_log(tmp_path)
    bag = as_bag(log, tmp_path / "walk_0.db3", definitions=definitions)
    found, wanted = scores(bag), scores(log)
    assert found.values == wanted.values
    assert {"mean_power", "tracking_error_linear", "action_rate"} <= set(found.values)
    assert dict(found.topics) == dict(wanted.topics)


def test_the_parts_of_a_bag_are_one_log_in_the_order_of_their_numbers(tmp_path):
    log, folder = walking_log(tmp_path), tmp_path / "walk"
    folder.mkdir()
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information:\n")
    cut = len(TIMES)
    as_bag(log, folder / "walk_2.db3", part=slice(cut))
    as_bag(log, folder / "walk_10.db3", part=slice(cut, None))
    packed = folder / "walk_2.db3"
    (folder / "walk_2.db3.zstd").write_bytes(zstandard.compress(packed.read_bytes()))
    packed.unlink()
    found = scores(folder)
    assert found.values == scores(log).values
    assert found.log == folder


def test_a_bag_of_unitree_s_messages_needs_no_definitions_of_its_own(tmp_path):
    from nw_sim.rollout.replaying.log_container import definition_of

    motor = dict.fromkeys(("ddq", "q_raw", "dq_raw", "ddq_raw"), 0.0)
    motor |= {"mode": 1, "temperature": 0, "lost": 0, "reserve": [0, 0], "dq": 1.0, "tau_est": 2.0}
    state = {
        "head": [0, 0], "level_flag": 0, "frame_reserve": 0, "sn": [0, 0], "version": [0, 0],
        "bandwidth": 0,
        "imu_state": {
            "quaternion": [1.0, 0.0, 0.0, 0.0], "gyroscope": [0.0] * 3,
            "accelerometer": [0.0] * 3, "rpy": [0.0] * 3, "temperature": 0,
        },
        "bms_state": {
            "version_high": 0, "version_low": 0, "status": 0, "soc": 0, "current": 0, "cycle": 0,
            "bq_ntc": [0, 0], "mcu_ntc": [0, 0], "cell_vol": [0] * 15,
        },
        "foot_force": [0] * 4, "foot_force_est": [0] * 4, "tick": 0, "wireless_remote": [0] * 40,
        "bit_flag": 0, "adc_reel": 0.0, "temperature_ntc1": 0, "temperature_ntc2": 0,
        "power_v": 0.0, "power_a": 0.0, "fan_frequency": [0] * 4, "reserve": 0, "crc": 0,
    }  # fmt: skip
    kind = "unitree_go/msg/LowState"
    log = tmp_path / "low.mcap"
    with log.open("wb") as stream:
        writer = Writer(stream)
        schema = writer.register_msgdef(kind, definition_of(kind))
        for time in TIMES.tolist():
            motors = [{**motor, "q": time} for _ in range(20)]
            ns = round((EPOCH + time) * 1e9)
            writer.write_message("/lowstate", schema, {**state, "motor_state": motors}, ns, ns)
        writer.finish()
    assert scores(as_bag(log, tmp_path / "low.db3")).values["mean_power"] == pytest.approx(24.0)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda bag: bag.execute("DROP TABLE messages"), "no tables `topics` and `messages`"),
        (lambda bag: bag.execute("UPDATE topics SET type = 'a/msg/B'"), "is not read"),
        (
            lambda bag: bag.executescript(
                "ALTER TABLE messages RENAME TO m;"
                "CREATE VIEW messages AS SELECT id, topic_id, timestamp, hex(data) AS data FROM m"
            ),
            "no tables `topics` and `messages`",
        ),
        (lambda bag: bag.execute("UPDATE messages SET data = 7"), "data of a message are no bytes"),
        (lambda bag: bag.execute("UPDATE topics SET type = 7"), "is not read"),
        (lambda bag: bag.execute("UPDATE topics SET name = x'00ff'"), "a topic is no text"),
        (lambda bag: bag.execute("UPDATE messages SET timestamp = 'late'"), "is damaged"),
    ],
)
def test_a_bag_that_is_none_is_an_error_of_that_file(tmp_path, spoil, words):
    path = as_bag(plain_log(tmp_path), tmp_path / "log.db3")
    with closing(sqlite3.connect(path)) as bag, bag:
        spoil(bag)
    with pytest.raises((StoreError, UsageError), match=words) as caught:
        scores(path)
    assert str(path) in str(caught.value)


def test_a_bag_whose_last_messages_lie_beside_it_is_not_whole(tmp_path):
    path = as_bag(plain_log(tmp_path), tmp_path / "log.db3")
    path.with_name("log.db3-wal").write_bytes(b"messages")
    with pytest.raises(UsageError, match=r"log\.db3 is not whole.*wal_checkpoint"):
        scores(path)


def test_a_cut_bag_is_damaged(tmp_path):
    path = as_bag(plain_log(tmp_path), tmp_path / "log.db3")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(StoreError, match=r"log\.db3 is damaged: database disk image is malformed"):
        scores(path)


@pytest.mark.parametrize("encoding", ["ros1", "json"])
def test_messages_of_another_encoding_are_named(tmp_path, encoding):
    path = tmp_path / "log.mcap"
    with path.open("wb") as stream:
        writer = Plain(stream)
        writer.start()
        schema = writer.register_schema(
            "foxglove.JointStates", {"ros1": "ros1msg", "json": "jsonschema"}[encoding], b"{}"
        )
        channel = writer.register_channel("/joint_states", encoding, schema)
        for time in range(10):
            writer.add_message(channel, time, json.dumps({"joints": []}).encode(), time)
        writer.finish()
    fix = "rosbags-convert" if encoding == "ros1" else "log one of"
    with pytest.raises(UsageError, match=f"is encoded as {encoding} .*; .*{fix}"):
        scores(path)


def test_messages_that_are_packed_one_by_one_are_unpacked(tmp_path):
    path, packed = plain_log(tmp_path), tmp_path / "packed.mcap"
    with path.open("rb") as stream, packed.open("wb") as out:
        writer = Plain(out)
        writer.start(profile="ros2")
        for schema, _, message in make_reader(stream).iter_messages():
            if message.sequence == 0:
                kind = writer.register_schema(schema.name, schema.encoding, schema.data)
                channel = writer.register_channel("/joint_states", "cdr", kind)
            data = zstandard.compress(message.data)
            writer.add_message(channel, message.log_time, data, message.publish_time)
        writer.finish()
    assert scores(packed).values["mean_power"] == pytest.approx(SINE, rel=0.01)


@pytest.mark.assets
@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("sine_true", {"mean_power": 7.6753}),
        ("sine_bursts", {"mean_power": 7.6753}),
        ("odo_turned_world", {"tracking_error_linear": math.sqrt(0.5), "mean_power": 24.0}),
        ("odo_turned_body", {"tracking_error_linear": None}),
        ("imu_ident_cov-1", {"base_roll_rms": None, "mean_power": 24.0}),
        ("imu_zero_quat", {"base_roll_rms": None, "mean_power": 24.0}),
        ("nan_effort", {"mean_power": None, "distance_before_fall": 1.98}),
        ("gap_10s", {"mean_power": 24.0}),
        ("first_time_zero", {"mean_power": 24.0, "distance_before_fall": 1.98}),
        ("pose_first_time_zero", {"distance_before_fall": 1.98}),
        ("lowstate", {"mean_power": 24.0}),
    ],
)
def test_logs_that_were_found(name, expected):
    path = ASSETS / "found/third/robot-logs" / f"{name}.mcap"
    if not path.is_file():
        pytest.skip("the third-party files are not here")
    found = scores(path)
    for score, value in expected.items():
        if value is None:
            assert found.missing[score]
        else:
            assert found.values[score] == pytest.approx(value, rel=1e-4)


@pytest.mark.parametrize(
    ("source", "kind", "field", "reading"),
    [
        ("joints", "unitree_go/msg/LowState", "motor_state", "joint_positions"),
        ("targets", "unitree_go/msg/LowCmd", "motor_cmd", "targets"),
    ],
)
def test_motors_of_unitree_are_counted_from_the_right_front_leg(source, kind, field, reading):
    """Unitree's documents count FR, FL, RR, RL, each hip, thigh, calf; 20 places, 12 of motors."""
    motors = [SimpleNamespace(q=float(n), dq=1.0, tau=2.0, tau_est=2.0) for n in range(20)]
    message = SimpleNamespace(**{field: motors})
    values = values_of(source, message, kind, GO1, {}, "/low")
    kinds = [
        f"{leg}_{part}" for leg in ("FR", "FL", "RR", "RL") for part in ("hip", "thigh", "calf")
    ]
    expected = [float(kinds.index(name.removesuffix("_joint"))) for name in GO1.joints]
    assert values[reading] == expected


# The account of fields.

SOURCE = {JOINT: "joints", ODOM: "pose", POSE: "pose", IMU: "imu", ARRAY: "targets"}
LAYOUT = {"dim": [], "data_offset": 0}
MARKED = {
    JOINT: lambda: joints(5.0),
    ODOM: lambda: odometry(5.0, yaw=0.5, place=(1, 2, 3), twist=(4, 5, 6)),
    POSE: lambda: {"header": header(5.0, "map"), "pose": odometry(yaw=0.5)["pose"]["pose"]},
    IMU: lambda: imu(5.0, orientation=turn(0.1, 0.2, 0.3), turning=(1, 2, 3)),
    TWIST: lambda: twist(0.5, 0.25),
    STAMPED: lambda: {"header": header(5.0, "base"), "twist": twist(0.5, 0.25)},
    ARRAY: lambda: {"layout": LAYOUT, "data": [0.5] * 12},
}


def leaves(message, path=()):
    """Yield where a number, text or array of a message is."""
    for name in message.__slots__:
        value = getattr(message, name)
        if hasattr(value, "__slots__"):
            yield from leaves(value, (*path, name))
        else:
            yield (*path, name)


def mark(message, path):
    """Change one field of a message."""
    for name in path[:-1]:
        message = getattr(message, name)
    value = getattr(message, path[-1])
    if isinstance(value, str):
        changed = value + "x"
    elif isinstance(value, list):
        changed = [each + ("x" if isinstance(each, str) else 0.125) for each in value] or [1]
    else:
        changed = value + (1 if isinstance(value, int) else 0.125)
    setattr(message, path[-1], changed)


def decode_one(tmp_path, kind, more=""):
    path = tmp_path / "one.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        schema = writer.register_msgdef(kind, f"{KINDS[kind]}\n{more}{PARTS}")
        writer.write_message("/topic", schema, {**MARKED[kind](), "mystery": 1.0}, log_time=1)
        writer.finish()
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return next(iter(reader.iter_decoded_messages())).decoded_message


def used_of(message, kind):
    source = SOURCE.get(kind, "command")
    frames = frames_of(message, kind) if source in {"pose", "imu"} else ()
    return values_of(source, message, kind, GO1, {}, "/topic"), stamp_of(message, kind), frames


@pytest.mark.parametrize("kind", MARKED)
def test_each_field_is_used_or_passed_over_or_noted(tmp_path, kind):
    uses, plain = FIELDS[kind], used_of(decode_one(tmp_path, kind), kind)
    covered = set()
    for path in leaves(decode_one(tmp_path, kind)):
        message = decode_one(tmp_path, kind)
        mark(message, path)
        (name,) = [each for each in uses if (".".join(path) + ".").startswith(f"{each}.")]
        covered.add(name)
        is_used, noted = used_of(message, kind) != plain, noted_in(message, kind)
        assert is_used == (uses[name] == USED), path
        assert noted == ([f"{name}, which is not read"] if uses[name] == NOTED else []), path
    assert covered == set(uses)


def test_a_field_that_nobody_knows_is_noted(tmp_path):
    message = decode_one(tmp_path, JOINT, more="float64 mystery\n")
    assert noted_in(message, JOINT) == ["mystery, which is not read"]
    entry = JointStates()
    entry.MergeFromString(bytes([10 << 3, 1]))  # field 10, a varint
    assert noted_in(entry, "foxglove.JointStates") == ["a field 10 of no name"]


@pytest.mark.parametrize("kind", ["foxglove.JointStates", "foxglove.PoseInFrame"])
def test_each_field_of_foxglove_has_a_use(kind):
    parts = {"joints": JointStates.DESCRIPTOR.fields_by_name["joints"].message_type}
    whole = {"foxglove.JointStates": JointStates, "foxglove.PoseInFrame": PoseInFrame}[kind]
    names = []
    for each in whole.DESCRIPTOR.fields:
        inner = parts.get(each.name) or (each.message_type if each.name == "pose" else None)
        names += [f"{each.name}.{part.name}" for part in inner.fields] if inner else [each.name]
    assert set(names) == set(FIELDS[kind])


def test_the_account_is_part_of_the_answer(tmp_path):
    found = scores(plain_log(tmp_path))
    assert found.fields["/joint_states"]["effort"] == USED
    assert found.fields["/joint_states"]["header.frame_id"].startswith("a joint has no frame")
