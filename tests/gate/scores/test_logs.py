"""Scores of logs: those of a run, to the digit, and those of a robot's own topics."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from itertools import pairwise

import mujoco
import numpy as np
import pytest
from mcap_ros2.writer import Writer
from ros_kinds import KINDS, PARTS

import nw_eval
from nw_base.errors import StoreError, UsageError
from nw_base.trials import Trial
from nw_eval import cli
from nw_gate.scores import BUILT_IN
from nw_policies import load_bundle
from nw_scenes.robots import get_robot
from nw_sim.catalogue import get_scene
from nw_sim.rollout.job import TrialJob
from nw_sim.rollout.record import attachments
from nw_sim.rollout.trial import run_trial

GO1 = get_robot("go1")
STAMP = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
STEPS, SUBSTEPS, T = 100, 4, 0.02


class Walk:
    """What a robot logs for two seconds: numbers that are known, and do not contradict others."""

    def __init__(self):
        rng = np.random.Generator(np.random.PCG64(3))
        shape = (STEPS * SUBSTEPS, 12)
        middle = np.array(GO1.default_pose)
        self.speeds = rng.normal(0.0, 5.0, shape)
        self.angles = middle + np.cumsum(self.speeds, axis=0) * T / SUBSTEPS
        self.torques = rng.normal(0.0, 8.0, shape)
        self.targets = middle + rng.normal(0.0, 0.2, (STEPS, 12))
        self.rolls = rng.normal(0.0, 0.1, STEPS)
        self.forward = rng.normal(0.5, 0.1, STEPS)
        self.places = np.stack([np.cumsum(self.forward * T), np.zeros(STEPS)], axis=1)
        self.turning = rng.normal(0.0, 0.1, STEPS)

    def write(self, path, *, efforts=True, odometry=True, order=tuple(range(12)), slow=1):
        names = [GO1.joints[index] for index in order]
        with path.open("wb") as stream:
            writer = Writer(stream)
            joint, odom, twist = (
                writer.register_msgdef(kind, KINDS[kind] + PARTS)
                for kind in (
                    "sensor_msgs/msg/JointState",
                    "nav_msgs/msg/Odometry",
                    "geometry_msgs/msg/Twist",
                )
            )

            def at(time, topic, schema, message):
                writer.write_message(topic, schema, message, log_time=round(time * 1e9) + 10**9)

            zero = {"x": 0.0, "y": 0.0, "z": 0.0}
            command = {"linear": {**zero, "x": 0.4}, "angular": {**zero, "z": 0.1}}
            at(0.0, "/cmd_vel", twist, command)
            # The state before the first step, from which on all topics are known.
            for fine in range(-1, STEPS * SUBSTEPS):
                time = (fine + 1) * T / SUBSTEPS
                if fine % slow == 0 or fine < 0:
                    row = max(fine, 0)
                    message = {
                        "header": STAMP,
                        "name": names,
                        "position": self.angles[row, list(order)].tolist(),
                        "velocity": self.speeds[row, list(order)].tolist(),
                        "effort": self.torques[row, list(order)].tolist() if efforts else [],
                    }
                    at(time, "/joint_states", joint, message)
                if (fine + 1) % SUBSTEPS:
                    continue
                step = max((fine + 1) // SUBSTEPS - 1, 0)
                message = {
                    "header": STAMP,
                    "name": names,
                    "position": self.targets[step, list(order)].tolist(),
                    "velocity": [],
                    "effort": [],
                }
                at(time, "/joint_commands", joint, message)
                half = self.rolls[step] / 2
                pose = {
                    "position": {"x": self.places[step, 0], "y": self.places[step, 1], "z": 0.3},
                    "orientation": {"w": math.cos(half), "x": math.sin(half), "y": 0.0, "z": 0.0},
                }
                moving = {
                    "linear": {**zero, "x": self.forward[step]},
                    "angular": {**zero, "z": self.turning[step]},
                }
                covariance = [0.0] * 36
                message = {
                    "header": STAMP,
                    "child_frame_id": "trunk",
                    "pose": {"pose": pose, "covariance": covariance},
                    "twist": {"twist": moving, "covariance": covariance},
                }
                if odometry:
                    at(time, "/odom", odom, message)
            writer.finish()


def job(scores=(), **more):
    scene = get_scene("hurdles/one_low_carpet")
    trial = Trial(
        suite="scored",
        suite_digest="d",
        suite_seed=3,
        scene=scene.name,
        scene_digest=scene.digest,
        task="hurdles",
        index=0,
    )
    return TrialJob(
        trial=trial,
        robot="go1",
        duration=12.0,
        scene=scene.name,
        policy="go1-parkour",
        checkpoint_digest=load_bundle("go1-parkour").checkpoint_digest,
        record="none",
        scores=tuple(scores),
        **more,
    )


def own_log(path, **more):
    card = load_bundle("go1-parkour").card_text
    return run_trial(job(mcap=path, attachments=attachments(card, ""), **more))


@pytest.fixture(scope="module")
def undeclared(tmp_path_factory):
    """The log of a run whose suite declared no scores."""
    path = tmp_path_factory.mktemp("run") / "log.mcap"
    own_log(path)
    return path


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """A walk that a robot logged, with all of its topics."""
    path = tmp_path_factory.mktemp("walk") / "bag.mcap"
    Walk().write(path)
    return path


def test_a_runs_log_gives_the_scores_of_the_run_whether_it_declared_them_or_not(
    tmp_path, undeclared
):
    expected = dict(own_log(tmp_path / "log.mcap", scores=BUILT_IN).scores)
    for path, recorded in ((tmp_path / "log.mcap", expected), (undeclared, {})):
        found = nw_eval.log_scores(path)
        assert found.values == pytest.approx(expected, rel=1e-9, abs=1e-9)
        assert set(found.values) == set(expected)
        assert set(found.missing) == {"tracking_error_linear", "tracking_error_angular"}
        assert dict(found.recorded) == recorded
        assert found.restored == 0


def test_a_runs_log_gives_them_under_perturbations_too(tmp_path):
    pushed = job(tuple(BUILT_IN), mcap=tmp_path / "log.mcap")
    trial = replace(pushed.trial, perturbation=(("payload", 2.0), ("push", 0.4)))
    card = load_bundle("go1-parkour").card_text
    result = run_trial(replace(pushed, trial=trial, attachments=attachments(card, "")))
    found = nw_eval.log_scores(tmp_path / "log.mcap", scores=["mean_power", "foot_slip"])
    assert set(found.values) == {"mean_power", "foot_slip"}
    for name, value in found.values.items():
        assert value == pytest.approx(dict(result.scores)[name], rel=1e-9)


def test_a_ros_2_bag_gives_the_scores_that_its_topics_allow(tmp_path):
    walk, path = Walk(), tmp_path / "bag.mcap"
    walk.write(path, order=tuple(reversed(range(12))))
    found = nw_eval.log_scores(path, robot="go1").values
    shares = np.abs(walk.torques) / np.array(GO1.torque_limits)
    power = np.maximum(walk.torques * walk.speeds, 0.0).sum(axis=1)
    places = [walk.places[0], *walk.places[9::10]]
    way = sum(math.dist(a, b) for a, b in pairwise(places))
    low, high = np.array(GO1.joint_ranges).T
    last = walk.angles[SUBSTEPS - 1 :: SUBSTEPS]
    ends = ((last < low + 0.01) | (last > high - 0.01)).any(axis=1)
    full = (shares >= 1.0).any(axis=1).reshape(STEPS, SUBSTEPS).any(axis=1)
    aside = walk.forward[:, None] - 0.4
    expected = {
        "mean_power": power.mean(),
        "peak_torque_share": shares.max(),
        "torque_rms_share": math.sqrt((shares**2).mean()),
        "limit_time": (ends | full).mean(),
        "action_rate": math.sqrt(((np.diff(walk.targets, axis=0) / T) ** 2).mean()),
        "action_acceleration": math.sqrt(((np.diff(walk.targets, 2, axis=0) / T**2) ** 2).mean()),
        "base_roll_rms": math.sqrt((walk.rolls**2).mean()),
        "base_pitch_rms": 0.0,
        "distance_before_fall": way,
        "tracking_error_linear": np.abs(aside).mean(),
        "tracking_error_angular": np.abs(walk.turning - 0.1).mean(),
    }
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, rel=1e-9, abs=1e-9), name
    assert found["cost_of_transport"] == pytest.approx(power.mean() * 2.0 / (WEIGHT * way))
    assert set(found) == {*expected, "cost_of_transport"}


WEIGHT = mujoco.MjModel.from_xml_string(GO1.mjcf).body_mass.sum() * 9.806
"""N of a Go1."""


def test_a_score_without_its_topic_says_which_one_is_missing(tmp_path, capsys):
    Walk().write(tmp_path / "bag.mcap", efforts=False, odometry=False)
    cli_exit(["scores", str(tmp_path / "bag.mcap"), "--robot", "go1"])
    lines = {line.split()[0]: line for line in capsys.readouterr().out.splitlines() if line}
    assert "/joint_states has no torques" in lines["mean_power"]
    assert "no topic has pose: nav_msgs/msg/Odometry" in lines["base_roll_rms"]
    assert "no message has foot positions" in lines["foot_slip"]
    assert "does not say how the task ended" in lines["time_to_finish"]
    assert float(lines["action_rate"].split()[1]) > 0.0


def test_json_has_numbers_and_topics(bag, capsys):
    cli_exit(["scores", str(bag), "--robot", "go1", "--json"])
    found = json.loads(capsys.readouterr().out)
    assert found["topics"] == {
        "joints": "/joint_states",
        "targets": "/joint_commands",
        "pose": "/odom",
        "command": "/cmd_vel",
    }
    assert found["seconds"] == pytest.approx(STEPS * T)
    assert found["scores"]["mean_power"]["unit"] == "W"


def cli_exit(arguments, code=0):
    with pytest.raises(SystemExit) as ended:
        cli.main(arguments)
    assert ended.value.code == code


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({}, "does not name its robot"),
        ({"robot": "nobodys"}, "unknown robot"),
        ({"robot": "go1", "topics": ["joints=/nothing"]}, "topic '/nothing' is not there"),
        ({"robot": "go1", "topics": ["joints=/odom"]}, "not joints"),
        ({"robot": "go1", "topics": ["feet=/odom"]}, "--topic feet="),
        ({"robot": "go1", "topics": ["/odom"]}, "--topic /odom"),
        ({"robot": "go1", "scores": ["nothing"]}, "'nothing' is not a score"),
    ],
)
def test_what_cannot_be_meant_is_named(bag, more, message):
    with pytest.raises(UsageError, match=message):
        nw_eval.log_scores(bag, **more)


def test_joints_that_are_logged_too_seldom_are_refused(tmp_path):
    Walk().write(tmp_path / "bag.mcap", slow=8)
    with pytest.raises(UsageError, match=r"/joint_states has 25\.\d messages a second"):
        nw_eval.log_scores(tmp_path / "bag.mcap", robot="go1")


def test_a_damaged_log_is_an_error_of_one_line(tmp_path, bag):
    whole = bag.read_bytes()
    rng = np.random.Generator(np.random.PCG64(1))
    for _ in range(20):
        damaged = bytearray(whole)
        for place in rng.integers(8, len(whole) - 8, 200):
            damaged[place] = rng.integers(256)
        (tmp_path / "cut.mcap").write_bytes(damaged)
        with pytest.raises((StoreError, UsageError)):
            nw_eval.log_scores(tmp_path / "cut.mcap", robot="go1")


def test_a_runs_log_takes_no_robot(undeclared, capsys):
    cli_exit(["scores", str(undeclared), "--robot", "go1"], code=2)
    assert "is the log of a run" in capsys.readouterr().err
