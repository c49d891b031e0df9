"""One thread for each worker: results depend on it, and so does the speed of two workers."""

from __future__ import annotations

import os
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Generator

# Read once, when the libraries start: NumPy's BLAS, torch, numba, Embree's scheduler.
_ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NUMEXPR_NUM_THREADS": "1",
    "VECLIB_MAXIMUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
    "PYTHONFAULTHANDLER": "1",
}


@contextmanager
def worker_environment() -> Generator[None]:
    """Let processes that start inside the `with` block inherit one thread for each library.

    A worker cannot set these itself: by the time its own code runs, its main module, and NumPy
    with it, may be imported already.
    """
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(_ONE_THREAD)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
