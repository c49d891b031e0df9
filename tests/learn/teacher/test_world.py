"""Levels go up and down, scenes that go badly come more often, and rewards say what is wanted."""

from dataclasses import replace

import numpy as np
import pytest

from nw_learn.teacher.config import GROUNDS, CourseSettings, RewardWeights, TrainingPhase
from nw_learn.teacher.curriculum import Curriculum
from nw_learn.teacher.episodes import POINTS, RobotMoments, rewards
from nw_learn.teacher.senses import bodies
from nw_scenes.robots import get_robot

SETTINGS = CourseSettings.model_validate({"variants": 2, "levels": 4, "start": [1, 1]})
TASKS = {"hurdles": 0.5, "gaps": 0.5, "ramps": 0.0, "stairs": 0.0, "flat": 0.0}
PHASE = {"share": 1.0, "timestep": 0.01, "std": 0.2, "tasks": TASKS, "scenes": 0.5}
POSE = np.array(get_robot("go1").default_pose)


class FewLanes:
    """Lanes as the curriculum sees them: 2 variants of 4 levels of each task, and two scenes."""

    scenes = ("easy", "hard")
    random_count = 34
    grounds = np.array([0] * 8 + [1] * 8 + [2] * 8 + [3] * 8 + [4] * 2 + [0, 0])

    def of_level(self, ground, level):
        return slice(8 * ground + 2 * level, 8 * ground + 2 * level + 2)


@pytest.fixture
def curriculum():
    made_of = Curriculum(10, SETTINGS, FewLanes(), np.random.default_rng(0))
    made_of.begin(TrainingPhase.model_validate(PHASE))
    return made_of


def test_robots_are_shared_out_among_the_tasks(curriculum):
    assert [GROUNDS[task] for task in curriculum.tasks] == ["hurdles"] * 5 + ["gaps"] * 5


def test_a_level_goes_up_with_success_and_down_with_failure_and_stays_between(curriculum):
    robots = np.array([5, 6, 7])
    curriculum.played[robots] = 1
    curriculum.judge(robots, np.array([10, 10, 10]), np.array([1.0, 0.25, 0.75]))
    assert curriculum.levels[robots, 1].tolist() == [2, 0, 1]
    # An easier level that is replayed, and an episode in a scene, change none.
    curriculum.played[5], curriculum.played[6] = 0, -1
    curriculum.judge(np.array([5, 0]), np.array([8, 35]), np.array([0.0, 1.0]))
    assert curriculum.levels[5, 1] == 2
    assert curriculum.places[1] > 0.5


def test_whoever_passes_the_top_goes_on_among_the_high_levels(curriculum):
    curriculum.levels[5, 1] = curriculum.played[5] = 3
    curriculum.judge(np.array([5]), np.array([14]), np.array([1.0]))
    assert curriculum.levels[5, 1] == 3


def test_scenes_that_go_badly_come_more_often(curriculum):
    curriculum.places[:] = [1.0, 0.0]
    lanes = curriculum.choose(np.zeros(600, dtype=np.intp))
    easy, hard = (lanes == 34).sum(), (lanes == 35).sum()
    assert 230 < easy + hard < 370
    assert hard > 5 * easy > 0
    assert set(lanes[lanes < 34]) <= {0, 1, 2, 3}


def moment(*, velocity=0.0, height=0.3, joints=POSE, **changes):
    """Return one robot over flat ground, walking along x."""
    qpos = np.concatenate([[0.0, 0.0, height, 1.0, 0.0, 0.0, 0.0], joints])[None]
    qvel = np.zeros((1, 18))
    qvel[0, 0] = velocity
    nothing = np.zeros(1)
    now = RobotMoments(
        body=bodies(qpos, qvel),
        direction=np.array([[1.0, 0.0]]),
        delta_yaw=nothing,
        joint_rates_before=np.zeros((1, 12)),
        torques=np.zeros((1, 12)),
        change=nothing,
        touching=nothing,
        on_edge=nothing,
        beneath=np.zeros((1, POINTS)),
        is_flat=np.ones(1, dtype=bool),
        is_sloped=np.zeros(1, dtype=bool),
    )
    return replace(now, **changes)


def worth(now):
    return rewards(now, RewardWeights.model_validate({}), POSE, 0.02).item()


def test_rewards_want_speed_up_to_the_commanded_one_and_heads_clear_of_what_is_ahead():
    walking = worth(moment(velocity=0.8))
    assert walking == pytest.approx(0.02 * (1.5 + 0.5 + 0.5))
    assert worth(moment(velocity=1.6)) == walking
    assert worth(moment()) == pytest.approx(0.02 * 1.0)
    low = np.zeros((1, POINTS))
    low[0, 1] = 0.3  # A hurdle 10 cm ahead of the head, higher than its chin.
    assert worth(moment(velocity=0.8, beneath=low)) == pytest.approx(
        walking - 0.02 * 1.0 * 1.389, abs=1e-4
    )
    low[0] = [0, 0, 0, 0, 0.243]  # Rear of the belly touches.
    assert worth(moment(velocity=0.8, beneath=low)) == pytest.approx(walking - 0.02 * 0.5)


@pytest.mark.parametrize(
    "changes",
    [
        {"touching": np.ones(1)},
        {"on_edge": np.ones(1)},
        {"change": np.ones(1)},
        {"torques": np.full((1, 12), 10.0)},
        {"joint_rates_before": np.full((1, 12), 5.0)},
        {"joints": POSE + 0.2},
        {"delta_yaw": np.ones(1)},
    ],
)
def test_everything_else_costs(changes):
    assert worth(moment(velocity=0.8, **changes)) < worth(moment(velocity=0.8)) - 1e-5


def test_no_step_costs_more_than_the_bound():
    assert worth(moment(velocity=-3.0, change=np.full(1, 99.0))) == pytest.approx(-0.4 * 0.02)
