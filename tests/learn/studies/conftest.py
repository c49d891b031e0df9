"""What tests of studies share: the text of a small one's config, and students in its scenes."""

import pytest

STUDENT = """
student:
  device: cpu
  rounds: 1
  trajectories: 2
  duration: 0.6
  budget: {steps: 300}
  sees: {rgb: false, depth: true, width: 16, height: 16, frames: 2}
  network: {chunk: 4, width: 16, heads: 2, feedforward: 16, convolutions: [8, 8]}
  learns: {batch_images: 4}
"""

SMALL = f"""
nw-study: 1
study: single-scene
name: small
seed: 3
scenes: [hurdles/one_low_carpet, hurdles/two_brick_dusk]
evaluation: {{trials: 2, duration: 0.4}}
{STUDENT}
"""


@pytest.fixture
def written(tmp_path):
    """Writes a config and returns its path."""

    def write(text):
        path = tmp_path / "study.yaml"
        path.write_text(text)
        return path

    return write


@pytest.fixture
def small():
    return SMALL
