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

from nw_base.confinement import ForkServer, Rules
from nw_base.confinement import fork_server as module
from nw_sim.rollout.confined import start

MODULE = "fork_server_functions"
SOURCE = """\
import os, sys, time

def tell(name, line): line.send((os.environ.get(name), os.getcwd(), os.getpid(), os.getppid()))
def imported(name, line): line.send(name in sys.modules)
def dies(code): os._exit(code)
def fails(): raise RuntimeError("nobody hears of it")
def sleeps(): time.sleep(600)
"""
OWNER = """\
import sys, time
from multiprocessing import Pipe
from nw_base.confinement import ForkServer, Rules, confine
import fork_server_functions

def sleeps_confined(line):
    confine(Rules())
    line.send("confined")
    fork_server_functions.sleeps()

if __name__ == "__main__":
    import owner
    fork_server = ForkServer()
    receiver, sender = Pipe(duplex=False)
    child = fork_server.fork(owner.sleeps_confined, (), (sender,))
    print(child.pid, flush=True)
    print(receiver.recv(), flush=True)
    time.sleep(600)
"""


@pytest.fixture
def functions(tmp_path, monkeypatch):
    (tmp_path / f"{MODULE}.py").write_text(SOURCE)
    monkeypatch.syspath_prepend(str(tmp_path))
    return __import__(MODULE)


@pytest.fixture(scope="module")
def fork_server():
    return ForkServer()


def ended(child):
    child.join(30.0)
    return child.exitcode


def heard(fork_server, function, *arguments):
    receiver, sender = Pipe(duplex=False)
    with receiver:
        with sender:
            child = fork_server.fork(function, arguments, (sender,))
        value = receiver.recv()
    assert ended(child) == 0
    return value


def is_running(pid):
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


def ends(pid):
    """Say whether a process ends by itself."""
    until = time.monotonic() + 60.0
    while is_running(pid) and time.monotonic() < until:
        time.sleep(0.01)
    return not is_running(pid)


def test_a_child_is_a_process_of_its_own_in_its_owners_surroundings(
    fork_server, functions, monkeypatch, tmp_path
):
    monkeypatch.setenv("NW_EVAL_WORD", "now")
    monkeypatch.chdir(tmp_path)
    word, folder, pid, parent = heard(fork_server, functions.tell, "NW_EVAL_WORD")
    assert (word, folder) == ("now", str(tmp_path))
    assert len({pid, parent, os.getpid()}) == 3
    monkeypatch.setenv("NW_EVAL_WORD", "later")
    assert heard(fork_server, functions.tell, "NW_EVAL_WORD")[0] == "later"


def test_what_the_fork_server_has_learnt_its_children_need_not_import(fork_server, functions):
    assert not heard(fork_server, functions.imported, "wave")
    fork_server.learn("wave", "no.such.module")
    assert heard(fork_server, functions.imported, "wave")


def test_how_a_child_ended_is_known_and_stays_known(fork_server, functions):
    child = fork_server.fork(functions.dies, (7,))
    assert [ended(child), child.exitcode] == [7, 7]
    assert ended(fork_server.fork(functions.fails, ())) == 70


def test_a_child_is_killed_and_its_number_is_its_own_until_then(fork_server, functions):
    child = fork_server.fork(functions.sleeps, ())
    assert child.exitcode is None
    child.kill()
    assert wait([child.sentinel], 30.0)
    os.kill(child.pid, 0)  # It has ended, and nobody else can have its number.
    assert child.exitcode == -signal.SIGKILL
    with pytest.raises(ProcessLookupError):
        os.kill(child.pid, 0)
    child.kill()
    child.close()


def test_threads_that_start_children_at_once_get_their_own(fork_server, functions):
    codes = {}

    def begin(code):
        codes[code] = ended(fork_server.fork(functions.dies, (code,)))

    threads = [threading.Thread(target=begin, args=(code,)) for code in range(1, 9)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60.0)
    assert codes == {code: code for code in range(1, 9)}


def test_children_end_with_a_fork_server_and_no_others_start_there(functions):
    fork_server = ForkServer()
    child = fork_server.fork(functions.sleeps, ())
    child_of_another_mind = fork_server.fork(functions.dies, (3,))
    assert wait([child_of_another_mind.sentinel], 30.0)
    fork_server._process.kill()
    fork_server._process.wait(30.0)
    assert not fork_server.is_alive
    with pytest.raises(OSError, match="is gone"):
        fork_server.fork(functions.dies, (0,))
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
    owner.stdout.readline()  # By now it has confined itself.
    assert is_running(child)
    owner.kill()
    owner.wait()
    owner.stdout.close()
    assert ends(child)


def test_a_setting_that_libraries_read_once_makes_another_fork_server(monkeypatch):
    first = start._open_fork_server()
    assert start._open_fork_server() is first
    monkeypatch.setenv("NW_EVAL_ANYTHING", "1")
    assert start._open_fork_server() is first
    monkeypatch.setenv("MKL_CBWR", "COMPATIBLE")
    assert start._open_fork_server() is not first


def test_limits_that_children_would_inherit_make_another_fork_server_and_so_do_those_lifted():
    first = start._open_fork_server()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2**20, before[1]))
    try:
        bounded = start._open_fork_server()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert bounded is not first
    assert start._open_fork_server() is not bounded


def test_without_a_fork_server_processes_start_from_nothing(functions, monkeypatch):
    def none():
        raise OSError("no pidfd here")

    monkeypatch.setattr(start, "_open_fork_server", none)
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
from nw_base.confinement import ForkServer

if __name__ == "__main__":
    fork_server = ForkServer()
    fork_server.learn("slow_import")
    print(fork_server._process.pid, flush=True)
    time.sleep(600)
"""
SLOW_IMPORT = """\
import time
from pathlib import Path

Path(__file__).with_name("begun").touch()
time.sleep(600)
"""


def appears(path):
    deadline = time.monotonic() + 60.0
    while not path.exists() and time.monotonic() < deadline:
        time.sleep(0.01)
    assert path.exists()


def test_a_fork_server_ends_with_its_owner_in_the_midst_of_an_import(tmp_path):
    (tmp_path / "owner.py").write_text(SLOW_OWNER)
    (tmp_path / "slow_import.py").write_text(SLOW_IMPORT)
    owner = subprocess.Popen([sys.executable, tmp_path / "owner.py"], stdout=subprocess.PIPE)
    fork_server = int(owner.stdout.readline())
    appears(tmp_path / "begun")
    assert is_running(fork_server)
    owner.kill()
    owner.communicate()
    assert ends(fork_server)  # The import goes on for longer than that is waited for.


@pytest.fixture
def stopped(functions, monkeypatch):
    """A fork server that was stopped after a child of it had ended with 7, and this child."""
    monkeypatch.setattr(module, "_LOOKS", 0.05)
    fork_server = ForkServer()
    child = fork_server.fork(functions.dies, (7,))
    assert wait([child.sentinel], 30.0)
    process = fork_server._process.pid
    os.kill(process, signal.SIGSTOP)
    while not module._is_stopped(process):
        time.sleep(0.001)
    yield fork_server, child
    child.close()


def test_a_fork_server_that_is_stopped_is_given_up_and_nobody_waits_for_it(stopped, functions):
    fork_server, child = stopped
    assert child.exitcode == -signal.SIGKILL  # Nobody can say.
    assert fork_server._process.wait(30.0) == -signal.SIGKILL
    assert not fork_server.is_alive
    with pytest.raises(OSError, match="is gone"):
        fork_server.fork(functions.sleeps, ())


def test_a_fork_server_that_is_stopped_and_goes_on_is_kept(stopped, monkeypatch):
    fork_server, child = stopped
    is_stopped, looks = module._is_stopped, []

    def look(process):
        looks.append(is_stopped(process))
        if len(looks) == module._STOPPED:
            os.kill(process, signal.SIGCONT)
        return looks[-1]

    monkeypatch.setattr(module, "_is_stopped", look)
    assert child.exitcode == 7
    assert looks[: module._STOPPED] == [True] * module._STOPPED
    assert fork_server.is_alive
