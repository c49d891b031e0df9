"""A student so small that it learns something within seconds, or nothing at all."""

from ruamel.yaml import YAML

from nw_learn.student.config import StudentConfig

SMALL = """
nw-train: 1
seed: 3
name: pupil
device: cpu
budget: {steps: 1000}
scenes: [hurdles/one_low_carpet]
rounds: 2
trajectories: 2
duration: 0.6
sees: {rgb: false, depth: true, width: 16, height: 16, frames: 2}
network: {chunk: 4, width: 16, heads: 2, feedforward: 16, convolutions: [8, 8]}
learns: {batch_images: 4}
"""


def small_config(**changes):
    return StudentConfig.model_validate(YAML(typ="safe", pure=True).load(SMALL) | changes)
