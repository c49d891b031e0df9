"""Functions for confined processes: they travel by name, so they live in a module of their own."""

import importlib

import pytest

SOURCE = '''\
import ctypes, fcntl, os, signal, socket, subprocess, sys, threading, time
from pathlib import Path


def called(*arguments):
    library = ctypes.CDLL(None, use_errno=True)
    if library.syscall(*arguments) < 0:
        raise OSError(ctypes.get_errno(), "refused")


def attempts(*, inside, outside, logs):
    """Try what a file that has taken its process over would try; return what came of each."""
    inside, outside, logs = Path(inside), Path(outside), Path(logs)
    came = {}

    def attempt(name, act):
        try:
            came[name] = repr(act())[:100]
        except BaseException as error:
            came[name] = type(error).__name__

    attempt("read inside", (inside / "file").read_text)
    attempt("read outside", (outside / "file").read_text)
    attempt("list outside", lambda: os.listdir(outside))
    attempt("read by a link", (inside / "link").read_text)
    attempt("read the parent's environment", Path(f"/proc/{os.getppid()}/environ").read_bytes)
    attempt("write inside", lambda: (inside / "file").write_text("mine"))
    attempt("write outside", lambda: (outside / "new").write_text("mine"))
    attempt("remove outside", (outside / "file").unlink)
    attempt("chmod outside", lambda: (outside / "file").chmod(0o777))
    file, idle = os.open(inside / "file", os.O_RDONLY), os.sched_param(0)
    attempt("change attributes", lambda: fcntl.ioctl(file, 0x40086602, bytes(8)))
    victim = bytes(outside / "file")
    attempt("change them by name", lambda: called(469, -100, victim, bytes(24), 24, 0))
    attempt("slow the parent", lambda: os.setpriority(os.PRIO_PROCESS, os.getppid(), 19))
    attempt("idle the parent", lambda: os.sched_setscheduler(os.getppid(), os.SCHED_IDLE, idle))
    attempt("write a log", lambda: (logs / "log").write_text("mine"))
    attempt("move a log", lambda: (logs / "log").rename(logs / "moved"))
    attempt("move a log out", lambda: (logs / "moved").rename(outside / "moved"))
    attempt("write by a link to a log", lambda: (logs / "taken.mcap").write_text("mine"))
    attempt("link to outside", lambda: (logs / "link").symlink_to(outside))
    attempt("socket", socket.socket)
    attempt("run", lambda: subprocess.run([sys.executable, "-c", ""]))
    attempt("fork", os.fork)
    attempt("kill the parent", lambda: os.kill(os.getppid(), 0))
    attempt("kill a group", lambda: os.kill(-1, 0))
    attempt("signal itself", lambda: os.kill(os.getpid(), 0))
    attempt("start a thread", lambda: threading.Thread(target=len, args=("",)).start())
    return came


def looks_for_accelerators():
    """Read what JAX reads to find accelerators, and try a device's memory."""
    devices = sorted(Path("/sys/bus/pci/devices").iterdir())
    facts = [int((device / "vendor").read_text(), 16) for device in devices]
    try:
        came = (devices[0] / "config").read_bytes()
    except OSError as error:
        came = type(error).__name__
    return [len(facts), came]


def fills_memory():
    import numpy as np
    return int(np.ones(2**31, np.uint8).sum())


def prints():
    os.write(1, b"from one\\n")
    os.write(2, b"from two\\n")


def spins(*, mark):
    Path(mark).write_text(str(os.getpid()))
    sum(range(10**15))  # In C, with the interpreter's lock: no thread of Python's runs meanwhile.


def leaves_children(*, mark):
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
    Path(mark).write_text(str(child.pid))
    time.sleep(600)


def modules():
    return sorted(sys.modules)
'''


@pytest.fixture
def functions(tmp_path, monkeypatch):
    folder = tmp_path / "code"
    folder.mkdir()
    (folder / "confined_functions.py").write_text(SOURCE)
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.delitem(__import__("sys").modules, "confined_functions", raising=False)
    return importlib.import_module("confined_functions")
