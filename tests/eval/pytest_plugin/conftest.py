"""Projects of a suite or two for pytest to run, with real rollouts of a tenth of a second."""

import shutil
from functools import partial

import pytest

from nw_base.files.shipped import shipped
from nw_eval import api
from nw_eval.pytest_plugin.runs import verdict_text

PLUGIN = ("-p", "nw_eval.pytest_plugin")
"""The only plugin besides pytest's own: installed or not, it is loaded once."""

SUITE = """\
nw-eval: 1
name: tiny
robot: go1
policy: stand
trials: {trials}
seed: 7
episode: {{duration: {duration}}}
scenes: [{scenes}]
record: none
{gate}
"""

FLAT = "flat/carpet_room"
BAR = "gate: {success_rate: 0.9}"

HERE = """\
import shutil
from functools import partial

from nw_eval import api

api.run = partial(api.run, in_process=True)
"""
"""A conftest.py: a worker's process takes seconds to start, and what it does is the same."""


@pytest.fixture(scope="session", autouse=True)
def _warm(tmp_path_factory):
    """Import what a run needs: pytester forgets what a session of its own has imported."""
    folder = tmp_path_factory.mktemp("warm")
    text = SUITE.format(trials=1, duration=0.1, scenes=FLAT, gate=BAR)
    (folder / "tiny.yaml").write_text(text)
    judged = api.run(folder / "tiny.yaml", out=folder / "run", in_process=True)
    assert verdict_text(judged).startswith(judged.verdict.verdict)


@pytest.fixture(autouse=True)
def _no_other_plugins(monkeypatch):
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")


@pytest.fixture
def suite(pytester):
    """Return a writer of suite files."""

    def write(name="tiny.yaml", *, scenes=(FLAT,), trials=1, duration=0.1, gate=BAR):
        path = pytester.path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        listed = ", ".join(scenes)
        path.write_text(SUITE.format(scenes=listed, trials=trials, duration=duration, gate=gate))
        return path

    return write


@pytest.fixture
def other(pytester):
    """Write another policy that does nothing, and return what one types for it."""
    shutil.copytree(shipped("policies") / "stand", pytester.path / "other")
    card = pytester.path / "other" / "policy.yaml"
    card.write_text(card.read_text().replace("name: stand", "name: other"))
    return "./other"


@pytest.fixture
def run(pytester, monkeypatch):
    """Return a function that runs pytest in this process, and its trials too."""
    monkeypatch.setattr(api, "run", partial(api.run, in_process=True))

    def run(*arguments):
        return pytester.runpytest_inprocess(*PLUGIN, *arguments)

    return run


@pytest.fixture
def folders(pytester):
    """Return a function that lists the folders of all runs of the project."""
    return lambda: sorted(path.parent for path in pytester.path.glob("reports/*/run.json"))


@pytest.fixture
def in_process_conftest(pytester):
    """Write a conftest.py, and return the arguments of a pytest that is a process of its own."""
    pytester.makeconftest(HERE)
    return (*PLUGIN, "-p", "xdist", "-p", "no:cacheprovider")
