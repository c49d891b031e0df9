"""One fork server for all tests: what reads logs and draws pages is forked, not started anew."""

import sys
from pathlib import Path

import pytest

from nw_sim.rollout.confined import start

sys.path.insert(0, str(Path(__file__).parent))

OF_TESTS = ("COLUMNS", "GITHUB_", "HOME", "MLFLOW_", "PY_COLORS", "USERPROFILE", "WANDB_")
"""Variables that tests set, and of which no library of the fork server has read any."""


@pytest.fixture(scope="session", autouse=True)
def _fork_server():
    """Start it before the first test, which takes 3 s of processor time, and keep it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(start, "_OURS", (*start._OURS, *OF_TESTS))
        start.prepare()
        yield
