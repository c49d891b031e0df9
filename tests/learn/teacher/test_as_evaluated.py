"""What a teacher trains in is what it is evaluated in: the same world, eyes, trail and ends."""

import numpy as np
import pytest

from nw_base.trials import Trial
from nw_learn.teacher.lanes import lane_of
from nw_learn.teacher.senses import FRAME, SCANDOTS, Senses, bodies
from nw_learn.teacher.simulation import Trails
from nw_scenes.robots import get_robot
from nw_sim.catalogue import get_scene
from nw_sim.physics import World
from nw_sim.physics.batch import Simulation
from nw_sim.rollout.job import StageClock, TrialJob
from nw_sim.rollout.library import Library
from nw_sim.rollout.opening import open_trial
from nw_sim.tasks.course import CourseProgress, distance_to_polyline

SCENE = "hurdles/three_high_wood_hall"


@pytest.fixture(scope="module")
def lane(trained_robot):
    return lane_of(get_scene(SCENE), trained_robot)


def test_physics_is_that_of_the_evaluation(lane, trained_robot):
    robot = get_robot("go1")
    simulation = Simulation(trained_robot, [lane.model], 2, threads=1)
    simulation.set_timestep(0.005)
    pose = np.concatenate([[1.3, 0.0, 0.4, 1.0, 0.0, 0.0, 0.0], robot.default_pose])
    simulation.put(np.arange(2), np.zeros(2, dtype=np.intp), np.tile(pose, (2, 1)))
    rng = np.random.default_rng(0)
    with World(robot, get_scene(SCENE)) as world:
        world.reset(position=pose[:3], yaw=0.0)
        for _ in range(60):
            targets = robot.default_pose + rng.uniform(-0.4, 0.4, 12)
            world.step(targets)
            simulation.step(np.tile(targets, (2, 1)))
            assert simulation.qpos[1] == pytest.approx(world._data.qpos, abs=1e-5)
        for _ in range(60):  # Standing still, since forces are those of one solve earlier.
            world.step(robot.default_pose)
            simulation.step(np.tile(robot.default_pose, (2, 1)))
        assert world.foot_forces().sum() > 20.0
        felt = np.concatenate([world.foot_forces(), list(world.monitored_forces().values())])
        assert simulation.touches()[0, :6] == pytest.approx(felt, abs=0.5)


def test_observations_are_those_of_the_card(lane):
    library = Library()
    scene = library.scene(SCENE)
    trial = Trial(
        suite="test",
        suite_digest="0" * 64,
        suite_seed=11,
        scene=scene.name,
        scene_digest=scene.digest,
        task=scene.task,
        index=0,
    )
    job = TrialJob(
        trial=trial,
        robot="go1",
        duration=3.0,
        scene=SCENE,
        policy="go1-parkour",
        checkpoint_digest=library.bundle("go1-parkour", None).checkpoint_digest,
        record="none",
    )
    senses = Senses(1, np.array(get_robot("go1").default_pose))
    everybody = np.arange(1)
    with open_trial(job, library, StageClock()) as opened:
        episode = opened.episode
        for _ in range(120):
            data = episode.world._data
            body = bodies(data.qpos[None], data.qvel[None])
            delta_yaw = np.array([episode._moment().delta_yaw])
            seen = senses.see(body, delta_yaw, everybody * 0, lane.heights[None], everybody)[0]
            decision = episode.decide()
            expected = np.concatenate([np.ravel(part) for part in decision.observation.values()])
            dots = slice(FRAME, FRAME + SCANDOTS)
            # Within half a cell of an edge the grid may have the other side's height.
            apart = np.abs(seen[dots] - expected[dots])
            assert (apart < 1e-4).mean() > 0.8
            seen[dots] = expected[dots]
            assert seen == pytest.approx(expected, abs=2e-6)
            senses.take(decision.action[None])
            episode.advance(decision)
            senses.feel(episode.world.foot_contacts[None])


def test_trails_count_as_the_evaluation_counts():
    rng = np.random.default_rng(2)
    points = np.array([[0.5, 0.1], [1.2, -0.1], [1.9, 0.0]])
    trails, progress = Trails(1), CourseProgress(np.c_[points, np.zeros(3)])
    trails.begin(np.arange(1), np.zeros((1, 2)), [points])
    position = np.zeros(2)
    for _ in range(400):
        target = progress.target[:2]
        position = position + 0.06 * (target - position) + rng.normal(0, 0.05, 2)
        progress.update(position)
        trails.update(position[None])
        assert trails.fraction[0] == progress.fraction
        aside = distance_to_polyline(position, np.vstack([[0.0, 0.0], points]))
        assert trails.aside(position[None])[0] == pytest.approx(aside)
        if progress.reached == progress.total:
            break
    assert trails.is_complete[0]
