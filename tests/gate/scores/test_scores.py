"""Scores are what their pages say: against logs, and against sums that are written out."""

import math
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from nw_base.trials import Trial
from nw_gate.scores import BUILT_IN, ScoreSpec, TrialEnd
from nw_policies import load_bundle
from nw_scenes.robots import get_robot
from nw_sim.catalogue import get_scene
from nw_sim.physics import World
from nw_sim.rollout.job import StageClock, TrialJob
from nw_sim.rollout.library import Library
from nw_sim.rollout.opening import open_trial
from nw_sim.rollout.scored import ScoreMeter
from nw_sim.rollout.trial import run_trial

PAGE = Path(__file__).parents[3] / "docs" / "reference" / "scores.md"
SCENE = "hurdles/one_low_carpet"


def job(scores=(), mcap=None, index=0, policy="go1-parkour", **more):
    trial = Trial(
        suite="scored",
        suite_digest="d",
        suite_seed=3,
        scene=SCENE,
        scene_digest=get_scene(SCENE).digest,
        task="hurdles",
        index=index,
    )
    return TrialJob(
        trial=trial,
        robot="go1",
        duration=12.0,
        scene=SCENE,
        policy=policy,
        checkpoint_digest=load_bundle(policy).checkpoint_digest,
        record="none",
        mcap=mcap,
        scores=tuple(scores),
        **more,
    )


def messages(path, topic):
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [message for *_, message in reader.iter_decoded_messages(topics=[topic])]


def test_scores_at_control_rate_are_those_of_the_states_in_the_log(tmp_path):
    path = tmp_path / "log.mcap"
    result = run_trial(job(BUILT_IN, mcap=path))
    found = dict(result.scores)
    assert result.outcome == "completed"
    assert set(found) == set(BUILT_IN) - {"tracking_error_linear", "tracking_error_angular"}
    poses = [each.pose for each in messages(path, "/robot/odom")][1:]  # The first is the start.
    assert len(poses) == result.steps
    roll, pitch = [], []
    for pose in poses:
        q = pose.orientation
        roll.append(math.atan2(2 * (q.w * q.x + q.y * q.z), 1 - 2 * (q.x**2 + q.y**2)))
        pitch.append(math.asin(2 * (q.w * q.y - q.z * q.x)))
    assert found["base_roll_rms"] == pytest.approx(np.sqrt(np.mean(np.square(roll))), rel=1e-5)
    assert found["base_pitch_rms"] == pytest.approx(np.sqrt(np.mean(np.square(pitch))), rel=1e-5)
    targets = np.array([list(each.targets) for each in messages(path, "/nw/policy")])
    rate, acceleration = np.diff(targets, axis=0) / 0.02, np.diff(targets, 2, axis=0) / 0.02**2
    assert found["action_rate"] == pytest.approx(np.sqrt(np.mean(rate**2)), rel=1e-5)
    assert found["action_acceleration"] == pytest.approx(
        np.sqrt(np.mean(acceleration**2)), rel=1e-5
    )
    places = [(pose.position.x, pose.position.y) for pose in poses]
    sampled = [places[0], *places[9::10]]
    if sampled[-1] != places[-1]:
        sampled.append(places[-1])
    way = sum(math.dist(a, b) for a, b in pairwise(sampled))
    assert found["distance_before_fall"] == pytest.approx(way, rel=1e-5)
    assert found["time_to_finish"] == pytest.approx(result.steps * 0.02)


class Asking:
    """A task that asks for a velocity every other second."""

    command = (0.3, 0.1, 0.2)


@pytest.mark.parametrize("steps", [7, 20, 87])
def test_every_score_at_physics_rate_is_its_formula_written_out(steps):
    robot, task, T, dt = get_robot("go1"), Asking(), 0.02, 0.005
    rng = np.random.Generator(np.random.PCG64(5))
    names = [name for name in BUILT_IN if name != "time_to_finish"]
    with World(robot, get_scene(SCENE), payload=2.0) as world:
        meter = ScoreMeter(names, world, task)
        mass = float(sum(world._model.body_mass))
        damping, limits = world._model.dof_damping[6:], np.array(robot.torque_limits)
        shares, powers, at_limit = [], [], 0
        slips, forces, errors, turns, places = [], [], [], [], []
        before = None
        for _ in range(steps):
            targets = np.array(robot.default_pose) + rng.normal(0.0, 0.6, 12)
            twin = mujoco.MjData(world._model)
            mujoco.mj_copyData(twin, world._model, world._data)
            twin.ctrl[:] = targets
            full = False
            for substep in range(4):
                (mujoco.mj_step2 if substep == 0 else mujoco.mj_step)(world._model, twin)
                torques = twin.actuator_force - damping * twin.qvel[6:]
                shares.append(np.abs(torques) / limits)
                powers.append(
                    sum(max(t * w, 0.0) for t, w in zip(torques, twin.qvel[6:], strict=True))
                )
                full |= bool((np.abs(torques) >= limits).any())
            world.step(targets)
            meter.take(targets)
            np.testing.assert_array_equal(twin.qvel, world._data.qvel)
            joints = world.joint_positions
            at_limit += full or any(
                not low + 0.01 <= q <= high - 0.01
                for q, (low, high) in zip(joints, robot.joint_ranges, strict=True)
            )
            feet = [world._data.geom(name).xpos.copy() for name in robot.feet]
            now = list(zip(feet, world.foot_forces().tolist(), strict=True))
            if before is not None:
                slips += [
                    math.dist(a[:2], b[:2]) / T
                    for (a, one), (b, two) in zip(before, now, strict=True)
                    if one > 2.0 and two > 2.0
                ]
            before = now
            forces.append(max(world.foot_forces()))
            yaw = world.roll_pitch_yaw[2]
            vx, vy, _ = world.trunk_linear_velocity
            ahead = math.cos(yaw) * vx + math.sin(yaw) * vy
            left = math.cos(yaw) * vy - math.sin(yaw) * vx
            errors.append(math.hypot(0.3 - ahead, 0.1 - left))
            turns.append(abs(0.2 - world.trunk_angular_velocity[2]))
            places.append(world.trunk_position[:2])
        found = dict(meter.values(TrialEnd(outcome="timeout", seconds=steps * T, success=0.0)))
    close = pytest.approx
    assert found["mean_power"] == close(sum(powers) * dt / (steps * T), rel=1e-9)
    assert found["peak_torque_share"] == close(np.max(shares), rel=1e-12)
    assert found["torque_rms_share"] == close(np.sqrt(np.mean(np.square(shares))), rel=1e-9)
    assert found["limit_time"] == close(at_limit / steps)
    if slips:
        assert found["foot_slip"] == close(np.mean(slips), rel=1e-9)
    assert ("foot_slip" in found) == bool(slips)
    assert found["contact_impulse"] == close(max(forces) * T)
    assert found["tracking_error_linear"] == close(np.mean(errors), rel=1e-9)
    assert found["tracking_error_angular"] == close(np.mean(turns), rel=1e-9)
    sampled = [places[0], *places[9::10], places[-1]]
    way = sum(math.dist(a, b) for a, b in pairwise(sampled))
    if way < 0.1:
        assert "cost_of_transport" not in found
    else:
        expected = sum(powers) * dt / (mass * 9.806 * way)
        assert found["cost_of_transport"] == close(expected, rel=1e-9)


def test_a_fall_leaves_tracking_undefined_and_no_finish_time():
    with World(get_robot("go1"), get_scene(SCENE)) as world:
        meter = ScoreMeter(["tracking_error_linear", "time_to_finish"], world, Asking())
        world.step(world.robot.default_pose)
        meter.take(np.array(world.robot.default_pose))
        assert meter.values(TrialEnd(outcome="fell", seconds=0.02, success=0.0)) == ()


def test_a_task_that_commands_nothing_leaves_tracking_undefined():
    with World(get_robot("go1"), get_scene(SCENE)) as world:
        meter = ScoreMeter(["tracking_error_angular"], world, SimpleNamespace(command=None))
        world.step(world.robot.default_pose)
        meter.take(np.array(world.robot.default_pose))
        assert meter.values(TrialEnd(outcome="timeout", seconds=0.02, success=0.0)) == ()


@pytest.mark.parametrize("at", [20, 33])
def test_a_trial_that_is_continued_from_its_middle_has_the_same_scores(at):
    library = Library()
    with open_trial(job(BUILT_IN), library, StageClock()) as whole:
        steps = whole.episode.steps()
        for _ in range(at):
            next(steps)
        steps.close()
        state = whole.episode.state()
        outcome = whole.episode.run()
        expected = whole.episode.scores(outcome)
    with open_trial(job(BUILT_IN), library, StageClock()) as later:
        later.episode.restore(state)
        assert later.episode.run() == outcome
        assert later.episode.scores(outcome) == expected


def test_measuring_changes_no_bit_of_a_trial():
    plain, scored = run_trial(job()), run_trial(job(BUILT_IN))
    assert scored.scores
    assert plain.scores == ()
    assert replace(scored, scores=(), wall=plain.wall, wall_seconds=plain.wall_seconds) == plain


def test_without_scores_a_state_has_no_part_for_them():
    with open_trial(job(), Library(), StageClock()) as trial:
        assert "scores" not in trial.episode.saved().parts
        assert {"trail", "termination"} <= trial.episode.saved().parts.keys()


def test_a_declaration_scales_the_worst_to_0_and_the_best_to_1():
    lower = ScoreSpec(
        name="x", unit="", better="lower", low=1.0, high=5.0, undefined=5.0, meaning="m"
    )
    assert [lower.scaled(each) for each in (None, 7.0, 5.0, 4.0, 1.0, 0.0)] == [0, 0, 0, 0.25, 1, 1]
    assert [lower.unscaled(each) for each in (0.0, 0.25, 1.0)] == [5.0, 4.0, 1.0]
    higher = lower.model_copy(update={"better": "higher", "undefined": 1.0})
    assert [higher.scaled(each) for each in (None, 2.0, 9.0)] == [0.0, 0.25, 1.0]
    assert higher.within(2.0, 4.0).scaled(3.0) == 0.5
    assert lower.within(1.0, 3.0).undefined == 3.0


def test_the_page_has_the_formula_of_every_score():
    text = PAGE.read_text(encoding="utf-8")
    formulas = text.partition("| score | formula |")[2].partition("\n\n")[0]
    told = re.findall(r"`(\w+)`", "".join(re.findall(r"^\|[^|]+\|", formulas, re.MULTILINE)))
    assert told == list(BUILT_IN)


def test_every_undefined_score_counts_as_the_worst():
    for cls in BUILT_IN.values():
        assert cls.spec.scaled(None) == 0.0
