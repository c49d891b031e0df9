"""The arena itself: every kind of misbehaviour that it watches for is seen."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent

# What a reader of `a.txt` does, and what must be said of it.
MISBEHAVIOUR = {
    "raise KeyError('x')": "KeyError",
    "raise SystemExit(0)": "SystemExit",
    "raise SceneError('something is wrong')": "does not name the file",
    "raise SceneError(['a.txt: one', 'two'])": "2 lines",
    "raise Raw('a.txt: ' + chr(27))": "control characters",
    "raise Raw('a.txt: ' + 'x' * 30000)": "a message of",
    "os.system('true')": "os.system",
    "subprocess.run(['true'])": "subprocess.Popen",
    "pickle.loads(pickle.dumps(Path('x')))": "pickle.find_class",
    "socket.socket().connect_ex(('127.0.0.1', 9))": "socket.connect",
    "(folder.parent.parent / 'outside').write_text('x')": "outside for writing",
    "(folder / 'own.py').write_text(''); sys.path.insert(0, str(folder)); import own": "import of",
    "time.sleep(600)": "no answer within 1 s",
    "x = bytearray(700_000_000)": "took",
    "os._exit(0)": "died",
    "os.kill(os.getpid(), 11)": "died",
}
HARMLESS = (
    "raise SceneError('a.txt: something is wrong')",
    "(folder / 'report.md').write_text('x')",
    "pass",
)
ARENA = """
import json, os, pickle, socket, subprocess, sys, time
from pathlib import Path
sys.path.insert(0, {here!r})
import arena
from nw_base.errors import SceneError
from targets import Target

arena.SECONDS, arena.BYTES = {seconds}, 500_000_000

class Raw(SceneError):
    def __str__(self):
        return self.args[0][0]

def read(folder):
    if folder.name.startswith("input-"):
        {act}

target = Target(name="t", seeds=lambda _: [{{"a.txt": b"a: 1" * 9}}], read=read)
print(json.dumps(arena.run(target, inputs=2, seed=1)))
"""


def findings(act):
    seconds = 1.0 if "sleep" in act else 60.0
    done = subprocess.run(
        [sys.executable, "-c", ARENA.format(here=str(HERE), act=act, seconds=seconds)],
        capture_output=True, text=True, check=False, env={**os.environ, "OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    return [finding["what"] for finding in json.loads(done.stdout)["findings"]]


@pytest.mark.parametrize(
    "act",
    [
        pytest.param(act, marks=() if number % 3 == 0 else pytest.mark.nightly)
        for number, act in enumerate(MISBEHAVIOUR)
    ],
)
def test_misbehaviour_is_seen(act):
    found = findings(act)
    assert len(found) >= 2
    assert all(MISBEHAVIOUR[act] in what for what in found[:2])


@pytest.mark.parametrize("act", HARMLESS)
def test_a_refusal_in_words_and_files_of_its_own_folder_are_no_findings(act):
    assert findings(act) == []
