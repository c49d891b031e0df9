"""Python files beside a card, imported as they are now."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def importable(folder: Path | None) -> Generator[None]:
    """Let modules of a folder be imported; nothing is let in for None.

    Python keeps what it has compiled beside the file, and takes it for the file's own if that has
    the same size and was written in the same second: an edited policy would run as it was. So
    nothing is kept of these modules, and nothing is written into the folder.
    """
    if folder is None:
        yield
        return
    path, keeps_none = str(folder.resolve()), sys.dont_write_bytecode
    sys.path.insert(0, path)
    sys.dont_write_bytecode = True
    try:
        importlib.invalidate_caches()
        yield
    finally:
        sys.dont_write_bytecode = keeps_none
        sys.path.remove(path)
