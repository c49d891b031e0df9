"""Reads a file that may be anything: no device, no pipe, nothing larger than it may be."""

from __future__ import annotations

import stat
from pathlib import Path


def bounded_bytes(path: Path, most: int) -> bytes:
    """Return the content of a plain file of at most `most` bytes.

    Raises:
        FileNotFoundError: there is none.
        OSError: it cannot be read.
        ValueError: it is too large, or a device or pipe, which may never end.
    """
    facts = path.stat()
    if not stat.S_ISREG(facts.st_mode):
        raise ValueError("it is not a file")
    if facts.st_size > most:
        raise ValueError(f"it has {facts.st_size / 2**20:.0f} MiB, over {most // 2**20}")
    with path.open("rb") as stream:
        return stream.read(most)
