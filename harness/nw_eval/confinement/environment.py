"""What children inherit: one thread for each library, no window system, no telemetry.

A process that a thread starts gets its environment as an argument: between fork and exec a child
reads the variables of its parent in place, and another thread's `setenv` may move them meanwhile
(POSIX.1-2017, `setenv`: not thread-safe). The child then fails with EFAULT, "Bad address".
"""

from __future__ import annotations

import os
import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Generator

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
