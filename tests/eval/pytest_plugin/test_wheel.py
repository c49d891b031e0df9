"""A project of its own, where nw-eval is installed from its wheel and pytest finds the plugin."""

import os
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import pytest

pytestmark = pytest.mark.nightly

ROOT = Path(__file__).parents[3]
SUITE = """\
nw-eval: 1
name: gate
robot: go1
policy: stand
trials: 4
seed: 7
episode: {duration: 0.2}
scenes:
  - flat/carpet_room
  - hurdles/one_low_carpet
record: none
gate: {success_rate: 0.9, tiers: {"hurdles/*": critical, "flat/*": informational}}
"""
BY_HAND = """\
def test_policy(nw_gate):
    assert not nw_gate("gate.nw.yaml").passed


def test_arithmetic():
    assert 1 + 1 == 2
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Return the Python of an environment with the wheels, and the test environment's libraries."""
    place = tmp_path_factory.mktemp("installed")
    build = [sys.executable, "-m", "build", "--no-isolation", "--wheel", "--outdir", str(place)]
    for project in (ROOT, *(file.parent for file in ROOT.glob("harness/*/pyproject.toml"))):
        subprocess.run([*build, str(project)], check=True, capture_output=True)
    wheels = map(str, place.glob("*.whl"))
    venv.create(place / "venv", with_pip=True)
    python = place / "venv" / "bin" / "python"
    install = [python, "-m", "pip", "install", "-q", "--no-deps", "--no-index", *wheels]
    subprocess.run(install, check=True)
    asked = [python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"]
    libraries = subprocess.run(asked, check=True, capture_output=True, text=True).stdout.strip()
    # Paths of a .pth are not searched for others: the checkout stays out of sight.
    Path(libraries, "libraries.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return python


@pytest.fixture
def run(installed, tmp_path):
    """Return a function that runs pytest in a project, and returns its exit code and its words."""
    (tmp_path / "gate.nw.yaml").write_text(SUITE)
    (tmp_path / "test_by_hand.py").write_text(BY_HAND)
    clean = {
        name: value for name, value in os.environ.items() if name[:6] not in {"PYTHON", "PYTEST"}
    }

    def run(*arguments):
        done = subprocess.run(
            [installed, "-m", "pytest", *arguments],
            cwd=tmp_path,
            env=clean,
            capture_output=True,
            text=True,
            check=False,
        )
        sys.stdout.write(f"$ pytest {' '.join(arguments)}\n{done.stdout}{done.stderr}\n")
        return done.returncode, done.stdout + done.stderr

    return run


def test_a_project_with_the_wheel_alone_has_suites_as_tests(run, installed):
    where = [installed, "-I", "-c", "import nw_eval; print(nw_eval.__file__)"]
    package = subprocess.run(where, check=True, capture_output=True, text=True).stdout
    assert package.startswith(str(installed.parent.parent))

    code, text = run("-v")
    assert code == pytest.ExitCode.TESTS_FAILED, text
    assert "gate.nw.yaml::flat/carpet_room PASSED" in text
    assert "gate.nw.yaml::hurdles/one_low_carpet FAILED" in text
    assert "gate.nw.yaml::verdict FAILED" in text
    assert "test_by_hand.py::test_policy PASSED" in text
    assert "2 failed, 3 passed" in text
    assert text.count("report: reports/gate-") >= 1

    code, text = run("--lf", "-v")
    assert "1 failed" in text
    assert "flat/carpet_room" not in text.split("short test summary")[0].split("collected")[1][:400]

    code, text = run("-n", "2", "gate.nw.yaml")
    assert "2 failed, 1 passed" in text

    code, text = run("-q", "test_by_hand.py", "-k", "arithmetic")
    assert (code, "nw" in text.replace("nw_eval", "nw")) == (0, False), "it is not heard of"
    code, text = run("-p", "no:nw_eval", "gate.nw.yaml")
    assert code == pytest.ExitCode.USAGE_ERROR, "without the plugin it is no test file"
