"""A whole run of a policy that attacks; prints what got through and what became of the victims.

    python attacked_run.py FOLDER LANDLOCK PYTHON

FOLDER is empty and this user's. LANDLOCK is `on`, `off`, or the version that the kernel is to have.
PYTHON is an interpreter for the card, or empty.
"""

import ctypes
import json
import os
import re
import subprocess
import sys
from pathlib import Path

CARD = """\
nw-policy: 1
name: mine
robot: go1
adapter: python:mine:Mine
control: {action: joint_position_offset, scale: 0.25}
observations: {body: {sensor: proprio, terms: [joint_pos]}}
"""
SUITE = """\
nw-eval: 1
name: attacked
robot: go1
policy: POLICY
trials: 1
seed: 1
episode: {duration: 0.1}
scenes: [flat/carpet_room]
record: none
"""
POLICY = """\
import json
from pathlib import Path
import probes

class Mine:
    def __init__(self, bundle):
        self.orders = json.loads((Path(__file__).parent / "orders.json").read_text())

    def reset(self, seed):
        probes.tried(own=__file__, **self.orders)

    def act(self, observation):
        return [0.0] * 12
"""
OLDER = """\
from nw_base.confinement import fence
real = fence.version
fence.version = lambda: min(real(), VERSION)
"""


def without_landlock():
    from nw_base.confinement.seccomp import Instruction, install

    steps = [Instruction(0x20, 0)]
    for number in (444, 445, 446):
        steps += [Instruction(0x15, number, if_false=1), Instruction(0x06, 0x00050026)]
    install([*steps, Instruction(0x06, 0x7FFF0000)])


def main():
    folder, landlock, python = Path(sys.argv[1]), *sys.argv[2:]
    environment = dict(os.environ, HOME=str(folder), XDG_CACHE_HOME=str(folder / "cache"))
    mine, outside = folder / "mine", folder / "outside"
    mine.mkdir()
    outside.mkdir()
    (outside / "secret").write_text("secret")
    os.setxattr(outside / "secret", "user.word", b"word")
    library = ctypes.CDLL(None)
    queue = library.msgget(0, 0o1600)
    assert queue >= 0
    assert library.msgsnd(queue, (ctypes.c_char * 16)(1), 4, 0) == 0
    victim = subprocess.Popen(["sleep", "600"])
    before = os.sched_getaffinity(victim.pid), os.getpriority(os.PRIO_PROCESS, victim.pid)
    orders = {"outside": str(outside), "victim": victim.pid, "queue": queue}
    (mine / "orders.json").write_text(json.dumps(orders))
    (mine / "policy.yaml").write_text(CARD + (f"python: {python}\n" if python else ""))
    (mine / "mine.py").write_text(POLICY)
    (mine / "probes.py").write_text((Path(__file__).parent / "probes.py").read_text())
    (folder / "suite.yaml").write_text(SUITE.replace("POLICY", str(mine)))
    if landlock == "off":
        without_landlock()
    elif landlock != "on":
        (folder / "older").mkdir()
        (folder / "older/sitecustomize.py").write_text(OLDER.replace("VERSION", landlock))
        environment["PYTHONPATH"] = str(folder / "older")
    command = [sys.executable, "-m", "nw_eval", "run", str(folder / "suite.yaml"), "--allow-code"]
    command += ["--no-cache", "--workers", "1", "--out", str(folder / "run")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    log = folder / "run/workers.log"
    said = re.findall("^probes (.*)$", log.read_text() if log.exists() else "", re.MULTILINE)
    count, through = json.loads(said[-1]) if said else (0, done.stdout + done.stderr)
    message = ctypes.create_string_buffer(64)
    answer = {
        "code": done.returncode,
        "tried": count,
        "through": through,
        "fence": json.loads((folder / "run/run.json").read_text())["fence"] if said else "",
        "victim lives": victim.poll() is None,
        "victim as before": before
        == (os.sched_getaffinity(victim.pid), os.getpriority(os.PRIO_PROCESS, victim.pid)),
        "message": library.msgrcv(queue, message, 32, 0, 0o4000),
        "secret": (outside / "secret").read_text(),
        "outside": sorted(path.name for path in outside.iterdir()),
    }
    library.msgctl(queue, 0, None)
    victim.kill()
    sys.stdout.write(json.dumps(answer))


if __name__ == "__main__":
    main()
