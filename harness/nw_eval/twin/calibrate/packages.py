"""The packages that calibration needs and that nw-eval does without otherwise."""

from __future__ import annotations

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
        return import_module(name)
    except ImportError as error:
        raise PrerequisiteError(
            f"calibration needs the package {name}: {error}", fix="pip install nw-eval[twin]"
        ) from error


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
