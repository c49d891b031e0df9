"""Paths that callers give as text: functions of the API make them paths first."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, overload

if TYPE_CHECKING:
    from os import PathLike


@overload
def as_path(path: str | PathLike[str]) -> Path: ...


@overload
def as_path(path: str | PathLike[str] | None) -> Path | None: ...


def as_path(path: str | PathLike[str] | None) -> Path | None:
    """Return a path, whatever it was given as; None stays None."""
    return None if path is None else Path(path)
