"""A finished run of half a second, once for all tests of the command line's ends."""

import pytest

from nw_eval import api

SUITE = """\
nw-eval: 1
name: tiny
robot: go1
policy: stand
trials: 2
seed: 7
episode: {duration: 0.2}
scenes: [flat/carpet_room]
record: none
gate: {success_rate: 0.9}
"""


@pytest.fixture(scope="session")
def regressed_run(tmp_path_factory):
    """Return the folder of a run whose verdict is REGRESSED: a robot that stands gets nowhere."""
    folder = tmp_path_factory.mktemp("judged")
    suite = folder / "suite.yaml"
    suite.write_text(SUITE)
    judged = api.run(suite, out=folder / "run", workers=2)
    assert judged.verdict.verdict == "REGRESSED"
    return folder / "run"
