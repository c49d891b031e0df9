"""The wall between a policy and what scores it: hostile code, and interpreters of their own."""

import os
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from nw_base.confinement import offered
from nw_base.errors import PolicyError
from nw_eval import api

SUITE = """\
nw-eval: 1
name: wall
robot: go1
policy: ./mine
trials: 8
seed: 1
episode: {duration: 0.1}
scenes: [hurdles/one_low_carpet]
gate: {success_rate: 0.75}
"""
CARD = """\
nw-policy: 1
name: mine
robot: go1
adapter: python:mine:Mine
control: {action: joint_position_offset, scale: 0.25}
observations: {body: {sensor: proprio, terms: [joint_pos]}}
"""
PATCHES = """\
import nw_sim.rollout.trial, nw_sim.physics
from nw_sim.tasks.course import CourseProgress
CourseProgress.reached = property(lambda self: self.total)
CourseProgress.update = lambda self, position: True
nw_sim.rollout.trial.run_trial = lambda *_, **__: None

class Mine:
    def __init__(self, bundle): pass
    def act(self, observation): return [0.0] * 12
"""
DEEDS = """\
import os, socket, subprocess, sys, time
from pathlib import Path

class Mine:
    def __init__(self, bundle):
        self.count = 0

    def act(self, observation):
        self.count += 1
        if self.count == 3 and not {spared}:
            {deed}
        return [0.0] * 12
"""

needs_fence = pytest.mark.skipif(
    not (offered().landlock and offered().seccomp), reason="the kernel has no fence"
)


@pytest.fixture
def evaluated(tmp_path):
    """Return what runs a policy of some code, and says how that ended."""
    folder = tmp_path / "mine"
    folder.mkdir()

    def run(code, *, card=CARD, duration=0.1, **how):
        (tmp_path / "suite.yaml").write_text(SUITE.replace("0.1", str(duration)))
        (folder / "policy.yaml").write_text(card)
        (folder / "mine.py").write_text(code)
        return api.run(
            tmp_path / "suite.yaml",
            out=tmp_path / "run",
            workers=1,
            cache=False,
            **{"allow_code": True, **how},
        )

    return run


def doing(deed, *, spared="False"):
    return DEEDS.format(deed=deed, spared=spared)


def test_a_policy_that_patches_the_scorer_changes_no_score(evaluated):
    report = evaluated(PATCHES)
    assert {row.outcome for row in report.rows} == {"timeout"}
    assert {row.success for row in report.rows} == {0.0}
    assert (report.verdict.verdict, report.exit_code) == ("REGRESSED", 1)


@needs_fence
@pytest.mark.parametrize(
    ("deed", "said"),
    [
        *(
            pytest.param(deed, "act raised PermissionError", marks=pytest.mark.nightly)
            for deed in (
                "os.fork()",
                "subprocess.run(['true'])",
                "socket.socket()",
                "os.kill(os.getppid(), 9)",
            )
        ),
        ("Path(__file__).with_name('new').write_text('mine')", "act raised PermissionError"),
        ("list(Path(__file__).parents[1].glob('run/*.json')) + os.listdir('/root')", "Permission"),
    ],
    ids=["fork", "start", "connect", "kill", "write", "read"],
)
def test_what_code_of_a_policy_may_not_do_fails_it_and_nothing_else(evaluated, deed, said):
    report = evaluated(doing(deed))
    assert {row.outcome for row in report.rows} == {"policy_failed"}
    assert all(said in row.error_text for row in report.rows), report.rows[0].error_text
    assert (report.verdict.verdict, report.exit_code) == ("REGRESSED", 1)


@pytest.mark.parametrize(
    ("deed", "outcome", "code"),
    [("os._exit(0)", "policy_failed", 1), ("os.abort()", "crashed", 4)],
    ids=["exit", "abort"],
)
def test_a_policy_that_ends_its_process_ends_no_run(evaluated, deed, outcome, code):
    report = evaluated(doing(deed))
    assert {row.outcome for row in report.rows} == {outcome}
    assert report.exit_code == code


def test_a_policy_that_sleeps_for_ever_is_hung(evaluated):
    report = evaluated(doing("time.sleep(1e6)"), time_limit=1.0, trials=1)
    assert {row.outcome for row in report.rows} == {"hung"}
    assert (report.verdict.verdict, report.exit_code) == ("INFRASTRUCTURE", 4)


LOOKS = """\
import sys
import numpy as np

class Mine:
    def __init__(self, bundle):
        assert "nw_sim.physics" not in sys.modules, "the harness is not here"
        self.gain = bundle.card.options["gain"]
        self.state_ = np.zeros(12)

    def reset(self, seed):
        self.state_ = np.random.default_rng(seed).normal(size=12)

    def act(self, observation):
        body = observation["body"]
        body *= 0.5  # Its own copy.
        self.state_ = 0.9 * self.state_ + self.gain * body
        return np.tanh(self.state_) * (1.0 if {where} else 0.0)

    def state(self):
        return self.state_.tobytes()

    def restore(self, state):
        self.state_ = np.frombuffer(state).copy()
"""


@pytest.fixture(scope="module")
def interpreter(tmp_path_factory):
    """Return the Python of an environment that has NumPy and nothing else of ours."""
    folder = tmp_path_factory.mktemp("env")
    made = subprocess.run(
        [sys.executable, "-m", "venv", "--without-pip", str(folder / "venv")], check=False
    )
    if made.returncode:
        pytest.skip("no environment can be made here")
    libraries = next((folder / "venv").glob("lib/python*/site-packages"))
    installed = Path(sysconfig.get_path("purelib"))
    for source in (*installed.glob("numpy*"),):
        for path in source.rglob("*"):
            target = libraries / path.relative_to(installed)
            if path.is_file() and "__pycache__" not in path.parts and "tests" not in path.parts:
                target.parent.mkdir(parents=True, exist_ok=True)
                try:
                    os.link(path, target)
                except OSError:
                    target.write_bytes(path.read_bytes())
    python = folder / "venv/bin/python"
    tried = subprocess.run([python, "-c", "import numpy"], check=False)
    if tried.returncode:
        pytest.skip("NumPy does not run from a copy")
    return python


def test_a_policy_in_an_environment_of_its_own_does_what_it_does_in_ours(
    evaluated, interpreter, tmp_path
):
    inside = f"sys.prefix == {str(interpreter.parents[1])!r}"
    options = "options: {gain: 0.3}\n"
    own = CARD + options + f"python: {interpreter}\n"
    there = evaluated(LOOKS.format(where=inside), card=own, duration=0.7, trials=1)
    assert {row.status for row in there.rows} == {"ok"}
    (tmp_path / "run").rename(tmp_path / "there")
    code = LOOKS.replace("assert", "True or").format(where="True")
    here = evaluated(code, card=CARD + options, duration=0.7, trials=1)
    assert [row.action_digest for row in here.rows] == [row.action_digest for row in there.rows]
    log = next((tmp_path / "there").rglob("*.mcap"))
    (tmp_path / "mine/mine.py").write_text(LOOKS.format(where=inside))
    (tmp_path / "mine/policy.yaml").write_text(own)
    whole = api.replay(log, allow_code=True)
    middle = api.replay(log, allow_code=True, start=0.6)
    assert whole.is_identical
    assert middle.is_identical
    assert middle.start_step > 0


@needs_fence
def test_code_in_an_environment_of_its_own_is_behind_the_fence_too(evaluated, interpreter):
    report = evaluated(doing("os.fork()"), card=CARD + f"python: {interpreter}\n")
    assert {row.outcome for row in report.rows} == {"policy_failed"}
    assert "act raised PermissionError" in report.rows[0].error_text


@needs_fence
def test_what_an_environment_runs_by_itself_is_behind_the_fence_too(
    evaluated, interpreter, tmp_path
):
    libraries = next(interpreter.parents[1].glob("lib/python*/site-packages"))
    mark, path = tmp_path / "mark", libraries / "starts.pth"
    path.write_text(f"import os; open({str(mark)!r}, 'w').close() if os.getppid() else None\n")
    try:
        subprocess.run([interpreter, "-c", "pass"], check=True)
        assert mark.exists(), "it runs where there is no fence"
        mark.unlink()
        evaluated(doing("pass"), card=CARD + f"python: {interpreter}\n", trials=1)
        assert not mark.exists()
    finally:
        path.unlink()


def test_an_interpreter_that_is_not_there_or_not_allowed_is_told(evaluated):
    with pytest.raises(PolicyError, match="add --allow-code"):
        evaluated(doing("pass"), card=CARD + "python: ./none\n", allow_code=False)
    with pytest.raises(PolicyError, match=r"none cannot be started: No such file"):
        evaluated(doing("pass"), card=CARD + "python: ./none\n")


@pytest.mark.parametrize(
    "is_own", [pytest.param(False, marks=pytest.mark.nightly), True], ids=["our Python", "its own"]
)
def test_a_short_action_says_what_it_is_wherever_it_comes_from(evaluated, interpreter, is_own):
    code = doing("return np.zeros(3)").replace("import os", "import numpy as np, os")
    report = evaluated(code, card=CARD + (f"python: {interpreter}\n" if is_own else ""))
    assert {row.end_reason for row in report.rows} == {"action"}
    assert "policy 'mine' returned an action of shape (3,)" in report.rows[0].error_text
