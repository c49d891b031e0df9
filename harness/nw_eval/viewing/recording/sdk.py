"""Rerun's library, which only its own files need."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from nw_eval.errors import PrerequisiteError

APPLICATION = "nw-eval"
"""The application of recordings and layouts; Rerun keeps one layout for each."""

_FIX = "pip install 'nw-eval[rerun]'"


def rerun_sdk() -> Any:
    """Return the package `rerun`, with its blueprints.

    Raises:
        PrerequisiteError: it is missing, too old, or another package of that name.
    """
    try:
        sdk: Any = import_module("rerun")
        import_module("rerun.blueprint")
    except ImportError as error:
        raise PrerequisiteError(f"Rerun's files need the package {error.name}", fix=_FIX) from error
    if not hasattr(sdk, "GaussianSplats3D"):
        found = getattr(sdk, "__version__", "another package")
        raise PrerequisiteError(f"Rerun's files need rerun-sdk 0.41, not {found}", fix=_FIX)
    return sdk
