"""A tiny run whose trials all fail, with a camera's pictures in their logs."""

import shutil

import pytest

from nw_eval import api

SUITE = """\
nw-eval: 1
name: tiny
robot: go1
policy: stand
trials: 2
seed: 5
episode: {duration: 0.6}
scenes: [hurdles/one_low_carpet]
record: all
"""


@pytest.fixture(scope="session")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("evidence")
    (folder / "tiny.yaml").write_text(SUITE)
    return api.run(folder / "tiny.yaml", out=folder / "run", workers=1)


@pytest.fixture
def run(recorded, tmp_path):
    """Return the folder of a copy of the run, which a test may damage, and its rows."""
    folder = tmp_path / "run"
    shutil.copytree(recorded.folder, folder)
    return folder, recorded.rows
