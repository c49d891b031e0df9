"""Processes that are forked from one that has imported what they need."""

import os
import resource
import signal
import subprocess
import sys
import threading
import time
from multiprocessing import Pipe
from multiprocessing.connection import wait
from pathlib import Path

import pytest

from nw_eval.confinement import Nursery, Rules
from nw_eval.rollout.confined import start

MODULE = "nursery_functions"
SOURCE = """\
import os, sys, time

def tell(name, line): line.send((os.environ.get(name), os.getcwd(), os.getpid(), os.getppid()))
def imported(name, line): line.send(name in sys.modules)
def dies(code): os._exit(code)
def fails(): raise RuntimeError("nobody hears of it")
def sleeps(): time.sleep(60)
"""
OWNER = """\
import sys, time
from nw_eval.confinement import Nursery, Rules, confine
import nursery_functions

def sleeps_confined():
    confine(Rules())
    nursery_functions.sleeps()

if __name__ == "__main__":
    import owner
    nursery = Nursery()
    child = nursery.fork(owner.sleeps_confined, ())
    print(child.pid, flush=True)
    time.sleep(60)
"""


@pytest.fixture
def functions(tmp_path, monkeypatch):
    (tmp_path / f"{MODULE}.py").write_text(SOURCE)
    monkeypatch.syspath_prepend(str(tmp_path))
    return __import__(MODULE)


@pytest.fixture(scope="module")
def nursery():
    return Nursery()


def ended(child):
    child.join(30.0)
    return child.exitcode


def heard(nursery, function, *arguments):
    receiver, sender = Pipe(duplex=False)
    with receiver:
        with sender:
            child = nursery.fork(function, arguments, (sender,))
        value = receiver.recv()
    assert ended(child) == 0
    return value


def is_running(pid):
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


def test_a_child_is_a_process_of_its_own_in_its_owners_surroundings(
    nursery, functions, monkeypatch, tmp_path
):
    monkeypatch.setenv("NW_EVAL_WORD", "now")
    monkeypatch.chdir(tmp_path)
    word, folder, pid, parent = heard(nursery, functions.tell, "NW_EVAL_WORD")
    assert (word, folder) == ("now", str(tmp_path))
    assert len({pid, parent, os.getpid()}) == 3
    monkeypatch.setenv("NW_EVAL_WORD", "later")
    assert heard(nursery, functions.tell, "NW_EVAL_WORD")[0] == "later"


def test_what_the_nursery_has_learnt_its_children_need_not_import(nursery, functions):
    assert not heard(nursery, functions.imported, "wave")
    nursery.learn("wave", "no.such.module")
    assert heard(nursery, functions.imported, "wave")


def test_how_a_child_ended_is_known_and_stays_known(nursery, functions):
    child = nursery.fork(functions.dies, (7,))
    assert [ended(child), child.exitcode] == [7, 7]
    assert ended(nursery.fork(functions.fails, ())) == 70


def test_a_child_is_killed_and_its_number_is_its_own_until_then(nursery, functions):
    child = nursery.fork(functions.sleeps, ())
    assert child.exitcode is None
    child.kill()
    assert wait([child.sentinel], 30.0)
    os.kill(child.pid, 0)  # It has ended, and nobody else can have its number.
    assert child.exitcode == -signal.SIGKILL
    with pytest.raises(ProcessLookupError):
        os.kill(child.pid, 0)
    child.kill()
    child.close()


def test_threads_that_start_children_at_once_get_their_own(nursery, functions):
    codes = {}

    def begin(code):
        codes[code] = ended(nursery.fork(functions.dies, (code,)))

    threads = [threading.Thread(target=begin, args=(code,)) for code in range(1, 9)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60.0)
    assert codes == {code: code for code in range(1, 9)}


def test_children_end_with_a_nursery_and_no_others_start_there(functions):
    nursery = Nursery()
    child = nursery.fork(functions.sleeps, ())
    child_of_another_mind = nursery.fork(functions.dies, (3,))
    assert wait([child_of_another_mind.sentinel], 30.0)
    nursery._process.kill()
    nursery._process.wait(30.0)
    assert not nursery.is_alive
    with pytest.raises(OSError, match="is gone"):
        nursery.fork(functions.dies, (0,))
    assert child_of_another_mind.exitcode == -signal.SIGKILL  # Nobody can say more.
    child.kill()


@pytest.mark.usefixtures("functions")
def test_nobody_outlives_an_owner_that_is_killed(tmp_path):
    (tmp_path / "owner.py").write_text(OWNER)
    owner = subprocess.Popen(
        [sys.executable, str(tmp_path / "owner.py")],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    child = int(owner.stdout.readline())
    time.sleep(0.5)  # It has confined itself by now.
    assert is_running(child)
    owner.kill()
    owner.wait()
    owner.stdout.close()
    until = time.monotonic() + 20.0
    while is_running(child) and time.monotonic() < until:
        time.sleep(0.05)
    assert not is_running(child)


def test_a_setting_that_libraries_read_once_makes_another_nursery(monkeypatch):
    first = start._open_nursery()
    assert start._open_nursery() is first
    monkeypatch.setenv("NW_EVAL_ANYTHING", "1")
    assert start._open_nursery() is first
    monkeypatch.setenv("MKL_CBWR", "COMPATIBLE")
    assert start._open_nursery() is not first


def test_limits_that_children_would_inherit_make_another_nursery_and_so_do_those_lifted():
    first = start._open_nursery()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2**20, before[1]))
    try:
        bounded = start._open_nursery()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert bounded is not first
    assert start._open_nursery() is not bounded


def test_without_a_nursery_processes_start_from_nothing(functions, monkeypatch):
    def none():
        raise OSError("no pidfd here")

    monkeypatch.setattr(start, "_open_nursery", none)
    receiver, sender = Pipe(duplex=False)
    with receiver, sender:
        process = start.start_process(
            functions.tell, ("HOME",), (sender,), rules=Rules(), is_one_of_many=True
        )
        assert receiver.recv()[3] == os.getpid()
    process.join(30.0)
    assert process.exitcode == 0


SLOW_OWNER = """\
import sys, time
from nw_eval.confinement import Nursery

if __name__ == "__main__":
    nursery = Nursery()
    nursery.learn("slow_import")
    print(nursery._process.pid, flush=True)
    time.sleep(60)
"""
SLOW_IMPORT = """\
import time
from pathlib import Path

Path(__file__).with_name("begun").touch()
time.sleep(3)
Path(__file__).with_name("ended").touch()
time.sleep(60)
"""


def appears(path):
    deadline = time.monotonic() + 60.0
    while not path.exists() and time.monotonic() < deadline:
        time.sleep(0.01)
    assert path.exists()


def test_a_nursery_ends_with_its_owner_in_the_midst_of_an_import(tmp_path):
    (tmp_path / "owner.py").write_text(SLOW_OWNER)
    (tmp_path / "slow_import.py").write_text(SLOW_IMPORT)
    owner = subprocess.Popen([sys.executable, tmp_path / "owner.py"], stdout=subprocess.PIPE)
    nursery = int(owner.stdout.readline())
    appears(tmp_path / "begun")
    assert is_running(nursery)
    owner.kill()
    owner.communicate()
    while is_running(nursery) and not (tmp_path / "ended").exists():
        time.sleep(0.01)
    assert not (tmp_path / "ended").exists()
    assert not is_running(nursery)


def test_a_nursery_that_is_stopped_is_given_up_and_nobody_waits_for_it(functions):
    nursery = Nursery()
    child = nursery.fork(functions.dies, (7,))
    assert wait([child.sentinel], 30.0)
    os.kill(nursery._process.pid, signal.SIGSTOP)
    assert child.exitcode == -signal.SIGKILL  # Nobody can say.
    assert nursery._process.wait(30.0) == -signal.SIGKILL
    assert not nursery.is_alive
    with pytest.raises(OSError, match="is gone"):
        nursery.fork(functions.sleeps, ())
    child.close()


def test_a_nursery_that_is_stopped_and_goes_on_is_kept(functions):
    nursery = Nursery()
    child = nursery.fork(functions.dies, (7,))
    assert wait([child.sentinel], 30.0)
    os.kill(nursery._process.pid, signal.SIGSTOP)
    threading.Timer(0.7, os.kill, (nursery._process.pid, signal.SIGCONT)).start()
    assert child.exitcode == 7
    assert nursery.is_alive
    child.close()
