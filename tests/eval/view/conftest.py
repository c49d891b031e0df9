"""Two runs of one suite: the shipped policy, and a robot that only stands."""

from __future__ import annotations

import pytest

import nw_eval

SUITE = """\
nw-eval: 1
name: looked-at
robot: go1
policy: go1-parkour
trials: 2
seed: 7
episode: {duration: 1.6}
scenes: [hurdles/one_low_carpet]
record: all
"""
FIRST = "hurdles-one_low_carpet-000"


@pytest.fixture(scope="session")
def runs(tmp_path_factory):
    """Return the folders of both runs."""
    folder = tmp_path_factory.mktemp("looked-at")
    suite = folder / "suite.yaml"
    suite.write_text(SUITE)
    for policy in ("go1-parkour", "stand"):
        nw_eval.run(suite, policy=policy, out=folder / policy, in_process=True)
    return folder / "go1-parkour", folder / "stand"


@pytest.fixture(scope="session")
def log(runs):
    """Return the log of the first trial of the shipped policy."""
    (path,) = runs[0].rglob(f"{FIRST}.mcap")
    return path
