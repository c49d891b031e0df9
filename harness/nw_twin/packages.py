"""The packages that only twins need."""

from __future__ import annotations

import ctypes
import re
import signal
import sys
import threading
from collections.abc import Generator
from contextlib import contextmanager, suppress
from importlib import import_module
from typing import Any

from nw_base.errors import PrerequisiteError


def package(name: str) -> Any:
    """Return a package of the extra `twin`.

    Raises:
        PrerequisiteError: it is missing, or does not start.
    """
    try:
        if name == "pycolmap" and name not in sys.modules:
            return _pycolmap()
        if name == "open3d" and name not in sys.modules:
            _load_libusb()
        return import_module(name)
    except ImportError as error:
        if re.search(r"lib\S+\.so\S*: cannot open shared object", str(error)):
            raise PrerequisiteError(
                f"the package {name} needs a library of the system: {error}",
                fix=f"on Debian and Ubuntu: apt-get install {_SYSTEM[name]}"
                if name in _SYSTEM
                else "install the system's package that holds it",
            ) from error
        raise PrerequisiteError(
            f"a twin needs the package {name.partition('.')[0]}: {error}",
            fix="pip install 'nw-eval[twin]'",
        ) from error


_SYSTEM = {"open3d": "libegl1 libgl1 libidn2-0 libudev1 libusb-1.0-0 libx11-6"}
"""What Debian calls the libraries that a package is linked to and does not bring."""


def _load_libusb() -> None:
    """Load libusb from its Python package, where the system has none.

    Open3D is linked to it for cameras that are not read here, and slim systems lack it. The loader
    takes a library of the same SONAME that is loaded already.
    """
    try:
        ctypes.CDLL("libusb-1.0.so.0", mode=ctypes.RTLD_GLOBAL)
    except OSError:
        with suppress(ImportError, OSError):
            path = import_module("libusb_package").get_library_path()
            ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)


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
    """Give pycolmap with its log turned off; failures show in its return values."""
    pycolmap = package("pycolmap")
    level = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = _FATAL
    try:
        yield pycolmap
    finally:
        pycolmap.logging.minloglevel = level
