"""Parents and children: gone together; and children out of reach of the terminal.

What children inherit: one thread for each library, no window system, no telemetry.

A process that a thread starts gets its environment as an argument: between fork and exec a child
reads the variables of its parent in place, and another thread's `setenv` may move them meanwhile
(POSIX.1-2017, `setenv`: not thread-safe). The child then fails with EFAULT, "Bad address".
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from contextlib import contextmanager, suppress
from multiprocessing import connection, parent_process
from types import ModuleType
from typing import TYPE_CHECKING

from nw_base.confinement import kernel

if TYPE_CHECKING:
    from collections.abc import Generator

LEFT = 73
"""Exit code of a policy's process whose caller is gone."""
GONE = 74
"""Exit code of a confined caller whose policy's process is gone: that one's code says why."""

_DEATH_OF_PARENT = 1  # prctl

_parent: int | None = None
"""Who forked this process, where that is not who owns it."""


def set_parent(process: int) -> None:
    """Say which process forked this one, in place of the one that asked for it."""
    global _parent  # noqa: PLW0603 - a process has one parent.
    _parent = process


def leave_terminal(output: int | None) -> None:
    """Make this process the first of a session of its own, and turn its output away.

    A terminal's signals do not reach it, and whoever kills its group kills what it started.

    Args:
        output: file descriptor for what it prints; None = nowhere.
    """
    with suppress(OSError):  # It is the first of a session already.
        os.setsid()
    nowhere = os.open(os.devnull, os.O_RDWR)
    os.dup2(nowhere, 0)
    for stream in (1, 2):
        os.dup2(nowhere if output is None else output, stream)
    if nowhere > 2:
        os.close(nowhere)


def die_with_parent(*, has_children: bool) -> None:
    """End this process when the one that started it ends, however that died.

    The kernel does it where it can, also in the midst of native code. Where this process may have
    children of its own, a thread must do it, to end them first.

    Args:
        has_children: whether code that runs here may start processes.
    """
    parent = parent_process()
    starter = _parent if _parent is not None else getattr(parent, "pid", None)
    if starter is None:
        return
    if not has_children:
        # The kernel means the thread that started this process: it waits for this process, or
        # lives as long as all of them.
        with suppress(OSError):
            kernel.prctl(_DEATH_OF_PARENT, signal.SIGKILL)
            if os.getppid() != starter:
                os._exit(1)
            return
    if parent is None:
        return
    threading.Thread(target=_wait_for, args=(parent.sentinel,), daemon=True).start()


@contextmanager
def interrupts_blocked() -> Generator[None]:
    """Start processes and threads that never see Ctrl-C.

    A terminal sends Ctrl-C to every process of its group. Masks pass to new threads and over
    `exec` to new processes, so workers, and those that replace them later, are deaf to it from
    their first instruction, and print no tracebacks while they import. `multiprocessing`'s own
    helper, if it is needed, must run already: starting it lifts the block. What this process hears
    meanwhile it hears at the end: a child would wait in vain for what it was to be handed.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        with _signals_heard_later():
            yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _signals_heard_later() -> Generator[None]:
    """Keep the handlers of signals waiting, which a mask does not: other threads have none."""
    if threading.current_thread() is not threading.main_thread():
        yield  # Python's handlers run in the main thread only.
        return
    heard: list[int] = []
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    held = {number: handler for number, handler in handlers.items() if callable(handler)}
    for number in held:
        signal.signal(number, lambda number, _: heard.append(number))
    try:
        yield
    finally:
        for number, handler in held.items():
            signal.signal(number, handler)
        for number in heard:
            signal.raise_signal(number)


@contextmanager
def without_script() -> Generator[None]:
    """Start processes that do not import the script which the caller runs.

    `spawn` would: a script that calls nw-eval outside of `if __name__ == "__main__"` would call it
    again in each of them, and none would start. Nothing that they are handed comes from there.
    """
    script = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = script


def kill_group(process: int | None) -> None:
    """Kill a child that was confined, and whatever it started; it must not be waited for yet."""
    with suppress(OSError):
        if process is not None and os.getpgid(process) == process:
            os.killpg(process, signal.SIGKILL)


def _wait_for(sentinel: int) -> None:
    connection.wait([sentinel])
    kill_group(os.getpid())
    os._exit(1)


_CHILDREN = {
    # Results depend on the number of threads, and so does the speed of two workers. Read once, when
    # the libraries start: NumPy's BLAS, torch, numba, Embree's scheduler.
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NUMEXPR_NUM_THREADS": "1",
    "VECLIB_MAXIMUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
    "PYTHONFAULTHANDLER": "1",
    "PYTHONBREAKPOINT": "0",  # A child has no terminal; `--in-process` is for that.
    "ORT_DISABLE_TELEMETRY": "1",  # onnxruntime would start a thread that sends.
}
_FENCED = {"MUJOCO_GL": "disable"}  # MuJoCo would start a program to look for OpenGL.

_changing = threading.Lock()


def inherited() -> dict[str, str]:
    """Return a copy of this process's environment, for a child that a thread starts."""
    with _changing:
        return dict(os.environ)


def environment_of_child() -> dict[str, str]:
    """Return the environment of a child that will confine itself; this process keeps its own."""
    return inherited() | _CHILDREN | _FENCED


@contextmanager
def child_environment(*, fenced: bool = True) -> Generator[None]:
    """Let processes that start inside the `with` block inherit what they need.

    A child cannot set these itself: by the time its own code runs, its main module, and NumPy
    with it, may be imported already. Where a process can be given its environment, as by
    `subprocess`, `environment_of_child` does it without a change here.

    Args:
        fenced: whether they will raise a fence round themselves.
    """
    wanted = _CHILDREN | _FENCED if fenced else _CHILDREN
    with _changing:
        before = {name: os.environ.get(name) for name in wanted}
        os.environ.update(wanted)
    try:
        yield
    finally:
        with _changing:
            for name, value in before.items():
                if value is None:
                    os.environ.pop(name, None)
                else:
                    os.environ[name] = value
