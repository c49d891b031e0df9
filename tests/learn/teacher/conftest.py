"""A training that takes seconds, and the robot that it trains."""

import textwrap

import pytest

from nw_learn.teacher.simulation import training_robot
from nw_learn.teacher.training import train_teacher
from nw_scenes.robots import get_robot

TINY = """\
    nw-train: 1
    seed: 5
    budget: {steps: 512}
    keep_every: 256
    ppo: {robots: 8, horizon: 16, minibatches: 2, epochs: 2, critic_first: 1}
    courses:
      {variants: 1, levels: 1, start: [0, 0], redraw: 1, scenes: [hurdles/three_high_wood_hall]}
    phases:
      - {share: 0.5, timestep: 0.01, std: 0.2, tasks: &tasks
         {hurdles: 0.5, gaps: 0.2, ramps: 0.1, stairs: 0.1, flat: 0.1}}
      - {share: 0.5, timestep: 0.005, std: 0.1, learning_rate: 0.0001, tasks: *tasks}
"""


@pytest.fixture(scope="session")
def trained_robot():
    """Return the Go1 as a training has it."""
    return training_robot(get_robot("go1"))


@pytest.fixture(scope="session")
def whole(tmp_path_factory):
    """Return a folder with a config of four updates in two phases, and its training in `run`."""
    folder = tmp_path_factory.mktemp("whole")
    (folder / "tiny.yaml").write_text(textwrap.dedent(TINY))
    trained = train_teacher(folder / "tiny.yaml", folder / "run", say=lambda _: None)
    assert trained.is_done
    return folder
