"""What children inherit: one thread for each library, no window system, no telemetry."""

from __future__ import annotations

import os
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
    "PYTHONBREAKPOINT": "0",  # Nobody sits in front of a child; `--in-process` is for that.
    "ORT_DISABLE_TELEMETRY": "1",  # onnxruntime would start a thread that sends.
}
_FENCED = {"MUJOCO_GL": "disable"}  # MuJoCo would start a program to look for OpenGL.


@contextmanager
def child_environment(*, fenced: bool = True) -> Generator[None]:
    """Let processes that start inside the `with` block inherit what they need.

    A child cannot set these itself: by the time its own code runs, its main module, and NumPy
    with it, may be imported already.

    Args:
        fenced: whether they will raise a fence round themselves.
    """
    wanted = _CHILDREN | _FENCED if fenced else _CHILDREN
    before = {name: os.environ.get(name) for name in wanted}
    os.environ.update(wanted)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
