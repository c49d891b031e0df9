"""Remembers in the user's cache that all kernels of a folder have been compiled.

Each kernel has its file there, and which files there should be is known to nobody before they are
called. The mark says only that it takes no time to call them: one that is wrong costs some.
"""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

from llvmlite import binding

from nw_eval.errors import StoreError
from nw_eval.files.cache import private_dir
from nw_eval.machine_code.jit import hash_sources

if TYPE_CHECKING:
    from pathlib import Path


def is_compiled(folder: Path) -> bool:
    """Return whether the kernels of a folder were compiled as they are, for this processor."""
    with suppress(OSError, StoreError):
        return _mark(folder).is_file()
    return False


def mark_compiled(folder: Path) -> None:
    """Remember that the kernels of a folder have been compiled, where anything can be kept."""
    with suppress(OSError, StoreError):
        mark = _mark(folder)
        if not mark.is_file():
            mark.touch()


def _mark(folder: Path) -> Path:
    name = f"{folder.parent.name}.{hash_sources(folder)}.{binding.get_host_cpu_name()}.compiled"
    return private_dir("kernels") / name
