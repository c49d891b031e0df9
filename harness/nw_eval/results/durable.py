"""What it takes for a file to survive a power cut."""

from __future__ import annotations

import os
import stat
from contextlib import suppress
from pathlib import Path


def sync_folder(folder: Path) -> None:
    """Wait until a folder's list of names is on disk; systems that cannot do so are left alone."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def bounded_bytes(path: Path, most: int) -> bytes:
    """Return the content of a plain file of at most `most` bytes.

    Raises:
        FileNotFoundError: there is none.
        OSError: it cannot be read.
        ValueError: it is too large, or a device or pipe, which may never end.
    """
    facts = path.stat()
    if not stat.S_ISREG(facts.st_mode):
        raise ValueError("it is no file")
    if facts.st_size > most:
        raise ValueError(f"it has {facts.st_size / 2**20:.0f} MiB, over {most // 2**20}")
    with path.open("rb") as stream:
        return stream.read(most)
