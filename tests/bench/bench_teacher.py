"""What a control step of a teacher's training costs: to collect it, and to learn from it.

    python tests/bench/bench_teacher.py

256 robots with the shipped policy on random courses and in the training scenes, both time steps of
the physics. Figures are processor time, the best of several updates, so that a busy machine
disturbs them little. Two cores do both at once: the slower one decides.
"""

from __future__ import annotations

import time

import numpy as np
import torch

from nw_learn.config import find_config, load_config, one_thread
from nw_learn.teacher.config import CourseSettings, TeacherConfig
from nw_learn.teacher.curriculum import Curriculum
from nw_learn.teacher.episodes import Episodes
from nw_learn.teacher.lanes import Lanes
from nw_learn.teacher.policy import begin
from nw_learn.teacher.simulation import training_robot
from nw_learn.teacher.training import PpoLearner, SampleCollector
from nw_scenes.robots import get_robot

GOAL = 8000
"""Control steps a second of two free cores, at 10 ms."""
UPDATES = 5


def cost(work):
    """Return what the cheapest of several calls costs, s of processor time."""
    costs = []
    for _ in range(UPDATES):
        start = time.process_time()
        work()
        costs.append(time.process_time() - start)
    return min(costs)


def main():
    one_thread()
    config = load_config(find_config("teacher"), TeacherConfig)
    beginning, ppo = begin(config), config.ppo
    courses = CourseSettings.model_validate({"variants": 1, "start": [3, 8]})
    robot, rng = training_robot(get_robot("go1")), np.random.default_rng(0)
    lanes = Lanes(courses, robot, seed=0)
    curriculum = Curriculum(ppo.robots, courses, lanes, rng)
    episodes = Episodes(robot, lanes, curriculum, config.rewards, rng, threads=1)
    generator = torch.Generator().manual_seed(0)
    seen = episodes.begin(config.phases[0])
    collector = SampleCollector(episodes, ppo, generator, seen)
    networks = beginning.actor, beginning.critic
    learner = PpoLearner(*networks, ppo, generator, torch.device("cpu"))
    learner.updates = ppo.critic_first
    samples = collector.collect(*networks, 0.2).samples
    learning = cost(lambda: learner.learn(samples)) / ppo.samples
    print(f"{'timestep':>9} {'collect':>9} {'learn':>9} {'one core':>10} {'two cores':>10}")
    for phase in (config.phases[0], config.phases[-1]):
        episodes.enter(phase)
        collecting = cost(lambda: collector.collect(*networks, 0.2)) / ppo.samples
        one, two = 1.0 / (collecting + learning), 1.0 / max(collecting, learning)
        print(
            f"{1e3 * phase.timestep:6.0f} ms {1e6 * collecting:6.0f} us {1e6 * learning:6.0f} us "
            f"{one:8,.0f}/s {two:8,.0f}/s"
        )
        if phase.timestep == 0.01 and two < GOAL:
            raise SystemExit(f"under {GOAL:,}/s on two cores")


if __name__ == "__main__":
    main()
