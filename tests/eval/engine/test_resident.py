"""What a process and its children hold: counted once, however many processes share it."""

import resource
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest

from nw_eval.engine.machine import Resident, can_be_listed

pytestmark = pytest.mark.skipif(not can_be_listed(), reason="no /proc that says it")

MB = 10**6
MAPPED = """
import mmap, sys
file = open(sys.argv[1], "rb")
shared = mmap.mmap(file.fileno(), 0, prot=mmap.PROT_READ)
sum(shared[at] for at in range(0, len(shared), 4096))
"""
HELD = "hoard = bytearray(100 * 10**6)"
STARTED_BY_A_THREAD = f"""
import subprocess, sys, threading
started = threading.Event()
def start():
    code = "{HELD}; print(flush=True); input()"
    child = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
    child.stdout.readline()
    started.set()
    child.wait()
threading.Thread(target=start, daemon=True).start()
started.wait()
"""


@contextmanager
def process(code, *words):
    """Run Python code, which then holds what it has until the block ends."""
    child = subprocess.Popen(
        [sys.executable, "-c", f"{code}\nprint(flush=True)\ninput()", *words],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        child.stdout.readline()
        yield child
    finally:
        child.kill()
        child.communicate()


def test_what_is_below_the_limit_is_not_told():
    with process(HELD) as holder:
        assert Resident(holder.pid).beyond(200 * MB) is None
        assert 100 * MB < Resident(holder.pid).beyond(80 * MB) < 130 * MB


def test_what_two_processes_share_counts_half_in_each(tmp_path):
    file = tmp_path / "splat"
    file.write_bytes(bytes(100 * MB))
    with process(MAPPED, str(file)) as one:
        assert Resident(one.pid).beyond(80 * MB) > 100 * MB
        with process(MAPPED, str(file)) as another:
            assert Resident(one.pid).beyond(80 * MB) is None
            assert 50 * MB < Resident(another.pid).beyond(40 * MB) < 80 * MB


def test_children_count_whichever_thread_started_them():
    with process(STARTED_BY_A_THREAD) as parent:
        assert Resident(parent.pid).beyond(80 * MB) > 100 * MB


def test_what_is_new_is_seen_while_shares_are_taken_as_known(tmp_path):
    file = tmp_path / "splat"
    file.write_bytes(bytes(100 * MB))
    grows = f"{MAPPED}\nprint(flush=True)\ninput()\n{HELD}"
    with process(MAPPED, str(file)), process(grows, str(file)) as grown:
        watched = Resident(grown.pid)
        assert watched.beyond(80 * MB) is None
        grown.stdin.write("\n")
        grown.stdin.flush()
        grown.stdout.readline()
        assert watched.beyond(80 * MB) > 140 * MB


def test_a_process_that_has_ended_holds_nothing():
    with process("") as short:
        watched = Resident(short.pid)
        short.kill()
        short.wait()
        watched.restrain(MB)
        assert watched.beyond(MB) is None


def test_a_process_with_a_limit_goes_first_and_cannot_reserve_the_machine():
    reserves = "input()\ntry: bytearray(3 * 10**9)\nexcept MemoryError: print('refused')"
    with process(f"print(flush=True)\n{reserves}") as greedy:
        Resident(greedy.pid).restrain(100 * MB)
        assert Path(f"/proc/{greedy.pid}/oom_score_adj").read_text() == "1000\n"
        assert greedy.communicate("\n")[0].split() == ["refused"]


def test_a_limit_that_is_there_is_never_loosened():
    with process(HELD) as confined:
        resource.prlimit(confined.pid, resource.RLIMIT_DATA, (500 * MB, 500 * MB))
        Resident(confined.pid).restrain(8000 * MB)
        assert resource.prlimit(confined.pid, resource.RLIMIT_DATA) == (500 * MB, 500 * MB)
