"""Projects of a suite or two for pytest to run, in this very process and with real rollouts."""

from functools import partial
from importlib.metadata import entry_points

import pytest

from nw_eval import api

INSTALLED = any(each.value == "nw_eval.pytest_plugin" for each in entry_points(group="pytest11"))
"""Whether pytest finds the plugin by itself; loaded twice, it would be refused."""

PLUGIN = () if INSTALLED else ("-p", "nw_eval.pytest_plugin")

SUITE = """\
nw-eval: 1
name: tiny
robot: go1
policy: stand
trials: {trials}
seed: 7
episode: {{duration: 0.1}}
scenes: [{scenes}]
record: none
{gate}
"""


@pytest.fixture
def suite(pytester):
    """Return a writer of suite files of a tenth of a second."""

    def write(
        name="tiny.yaml", *, scenes="flat/carpet_room", trials=1, gate="gate: {success_rate: 0.9}"
    ):
        path = pytester.path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(SUITE.format(scenes=scenes, trials=trials, gate=gate))
        return path

    return write


@pytest.fixture
def run(pytester, monkeypatch):
    """Return a function that runs pytest here, with trials in this process."""
    # A worker's process takes seconds to start; what it does is the same.
    monkeypatch.setattr(api, "run", partial(api.run, in_process=True))

    def run(*arguments):
        return pytester.runpytest_inprocess(*PLUGIN, "-p", "no:randomly", *arguments)

    return run
