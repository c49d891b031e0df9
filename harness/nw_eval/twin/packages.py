"""The packages that only twins need."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Generator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from nw_eval.errors import PrerequisiteError


def package(name: str) -> Any:
    """Return a package of the extra `twin`.

    Raises:
        PrerequisiteError: it is missing, or does not start.
    """
    try:
        if name == "pycolmap" and name not in sys.modules:
            return _pycolmap()
        return import_module(name)
    except ImportError as error:
        raise PrerequisiteError(
            f"a twin needs the package {name.partition('.')[0]}: {error}",
            fix="pip install nw-eval[twin]",
        ) from error


def _pycolmap() -> Any:
    """Return pycolmap, whose import takes SIGTERM away, to print where its C++ is: give it back."""
    before = signal.getsignal(signal.SIGTERM)
    pycolmap = import_module("pycolmap")
    if threading.current_thread() is threading.main_thread() and before is not None:
        signal.signal(signal.SIGTERM, before)
    return pycolmap


_FATAL = 3
"""Of glog's levels, the one that ends the process."""


@contextmanager
def quiet() -> Generator[Any]:
    """Give pycolmap, which logs nothing meanwhile: what fails is seen by what it returns."""
    pycolmap = package("pycolmap")
    level = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = _FATAL
    try:
        yield pycolmap
    finally:
        pycolmap.logging.minloglevel = level
