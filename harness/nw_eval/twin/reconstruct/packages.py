"""Packages that only twins need."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from nw_eval.errors import PrerequisiteError


def package(name: str) -> Any:
    """Return a package of the extra `twin`.

    Raises:
        PrerequisiteError: it is not installed.
    """
    try:
        return import_module(name)
    except ImportError as error:
        raise PrerequisiteError(
            f"reconstruction needs {name.partition('.')[0]}: {error}",
            fix="pip install nw-eval[twin]",
        ) from None
