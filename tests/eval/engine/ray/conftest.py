"""`nw-eval run --engine ray` as a shell starts it, and clusters that it can join."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

import raylets

MAIN = "from nw_eval.cli import main; main()"


def nw_eval(*arguments, env=None, **options):
    """Start `nw-eval` in a process of its own, as a shell would."""
    command = [sys.executable, "-c", MAIN, *map(str, arguments)]
    return subprocess.Popen(
        command,
        env=os.environ | (env or {}),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
        **options,
    )


@pytest.fixture
def cluster():
    """An empty cluster: start its head first."""
    with raylets.empty_cluster() as empty:
        yield empty


@pytest.fixture(name="nw_eval")
def _nw_eval():
    return nw_eval


@pytest.fixture(name="until")
def _until():
    return raylets.until


@pytest.fixture
def tiny(tmp_path):
    """Return the file of a suite of trials of a fifth of a second, seen by nobody."""
    path = tmp_path / "tiny.yaml"
    path.write_text(
        "nw-eval: 1\nname: tiny\nrobot: go1\npolicy: stand\ntrials: 2\nseed: 7\n"
        "episode: {duration: 0.2}\nscenes: [flat/carpet_room]\nrecord: none\n"
    )
    return path
