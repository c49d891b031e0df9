"""Policies that attack, in whole runs: as root and as somebody else, with and without Landlock."""

import json
import os
import runpy
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

import pytest

from nw_base.confinement import offered

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not (offered().landlock >= 3 and offered().seccomp), reason="this kernel has no whole fence"
    ),
]

HERE = Path(__file__).parent
NOBODY = "54321"
HIDE = """\
set -e
mount --bind "$1" "$3"
mount -t tmpfs -o mode=755 tmpfs "$2"
mkdir -p "$1"
mount --bind "$3" "$1"
shift 3
exec "$@"
"""
"""Shows one folder of a folder that others may not enter, in a mount namespace of its own."""


def closed_ancestor(path):
    """Return the topmost folder above a path that others may not enter; None = there is none."""
    ancestors = [*Path(path).resolve().parents][::-1]
    return next((folder for folder in ancestors if not folder.stat().st_mode & 0o001), None)


@pytest.fixture
def place():
    """Return an empty folder that any user can reach."""
    with tempfile.TemporaryDirectory(prefix="nw-eval-attacks-") as name:
        Path(name).chmod(0o755)
        yield Path(name)


@pytest.fixture(params=["root", "somebody"])
def as_user(request, place):
    """Return what a command begins with that a user runs; `place` becomes this user's."""
    if os.geteuid() != 0:
        if request.param == "root":
            pytest.skip("not root")
        return []
    if request.param == "root":
        return []
    (place / "held").mkdir()
    prefix = []
    if closed := closed_ancestor(sys.base_prefix):
        prefix = ["unshare", "-m", "sh", "-c", HIDE, "sh", sys.base_prefix, closed, place / "held"]
    prefix += ["setpriv", "--reuid", NOBODY, "--regid", NOBODY, "--clear-groups"]
    os.chown(place, int(NOBODY), int(NOBODY))
    tried = subprocess.run([*prefix, sys.executable, "-c", "import nw_eval"], check=False)
    if tried.returncode:
        pytest.skip("another user cannot run this Python")
    return prefix


FILES = ("read ", "list ")
"""What Landlock alone refuses."""


@pytest.mark.parametrize(
    ("landlock", "python"),
    [
        pytest.param("on", "", id="whole"),
        pytest.param("5", "", id="older Landlock", marks=pytest.mark.nightly),
        pytest.param("off", "", id="no Landlock", marks=pytest.mark.nightly),
        pytest.param("on", sys.executable, id="a Python of its own", marks=pytest.mark.nightly),
    ],
)
def test_no_attack_of_a_policy_gets_through(place, as_user, landlock, python):
    (folder := place / "run").mkdir()
    if as_user:
        os.chown(folder, int(NOBODY), int(NOBODY))
    done = subprocess.run(
        [*as_user, sys.executable, HERE / "attacked_run.py", folder, landlock, python],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    through = answer.pop("through")
    assert answer.pop("tried") > 400, through
    if landlock == "off":
        assert any(name.startswith("read ") for name in through), "the mask works"
        through = [name for name in through if not name.startswith(FILES)]
    assert not through
    version = {"on": f"landlock {offered().landlock}", "5": "landlock 5", "off": "no Landlock"}
    assert answer == {
        "code": 0,
        "fence": f"{version[landlock]}, seccomp",
        "victim lives": True,
        "victim as before": True,
        "message": 4,
        "secret": "secret",
        "outside": ["secret"],
    }


CLINGS = """\
import ctypes, os, signal, time
from pathlib import Path

class Mine:
    def __init__(self, bundle):
        self.count = 0

    def act(self, observation):
        self.count += 1
        if self.count < 3:
            return [0.0] * 12
        library = ctypes.CDLL(None)
        library.prctl(1, 0, 0, 0, 0)
        signal.pthread_sigmask(signal.SIG_BLOCK, range(1, 65))
        for number in set(range(1, 65)) - {9, 19, 32, 33}:
            try:
                signal.signal(number, signal.SIG_IGN)
            except (OSError, ValueError):
                pass
        library.setsid()
        os.closerange(0, 1000)
        while True:
            time.sleep(1)
"""
RUN = """\
import os, subprocess, sys
sys.argv[1:] = ["run", "suite.yaml", "--allow-code", "--no-cache", "--workers", "1", "--out", "run"]
from nw_eval.cli import main
main()
"""


def processes():
    """Return the number of each process that runs, and of the one that started it."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            state, parent, *_ = (folder / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if state != "Z":
            found[int(folder.name)] = int(parent)
    return found


def below(top):
    """Return the processes that one has started, and those that they have."""
    parents = processes()
    found = {top}
    while more := {process for process, parent in parents.items() if parent in found} - found:
        found |= more
    return found - {top}


def clings(process):
    """Return whether a process has blocked all signals that it can."""
    try:
        status = Path(f"/proc/{process}/status").read_text()
    except OSError:
        return False
    return int(status.partition("SigBlk:")[2].split()[0], 16).bit_count() > 50


@pytest.mark.parametrize(
    "python",
    [
        pytest.param("", id="our Python"),
        pytest.param(sys.executable, id="its own", marks=pytest.mark.nightly),
    ],
)
def test_a_policy_that_clings_to_life_dies_with_a_run_that_is_killed(place, as_user, python):
    texts = runpy.run_path(str(HERE / "attacked_run.py"))
    (folder := place / "run").mkdir()
    (folder / "mine").mkdir()
    (folder / "mine/policy.yaml").write_text(
        texts["CARD"] + (f"python: {python}\n" if python else "")
    )
    (folder / "mine/mine.py").write_text(CLINGS)
    (folder / "suite.yaml").write_text(texts["SUITE"].replace("POLICY", "./mine"))
    if as_user:
        os.chown(folder, int(NOBODY), int(NOBODY))
    environment = dict(os.environ, HOME=str(folder), XDG_CACHE_HOME=str(folder / "cache"))
    run = subprocess.Popen(
        [*as_user, sys.executable, "-c", RUN], cwd=folder, env=environment, start_new_session=True
    )
    try:
        deadline = time.monotonic() + 120.0
        while not (clinging := set(filter(clings, below(run.pid)))):
            assert run.poll() is None, "it ended before the policy was asked"
            assert time.monotonic() < deadline, "no policy got going"
            time.sleep(0.1)
        family = below(run.pid)
        assert clinging <= family
        run.kill()
        run.wait()
        deadline = time.monotonic() + 20.0
        while (left := family & processes().keys()) and time.monotonic() < deadline:
            time.sleep(0.1)
        assert not left
    finally:
        for process in (*below(run.pid), run.pid):
            with suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)
