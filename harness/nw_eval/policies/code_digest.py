"""The identity of code that a card imports: one digest over the Python files in its folder."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from nw_eval.errors import PolicyError

CODE_LIMIT = 2**26
"""Bytes of all files together: 64 MiB, more than any policy's code."""

SCOPE = "code outside the card's folder is not part of it"
"""What every text that shows the digest says beside it."""


def code_digest(folder: Path) -> str:
    """Return the hex SHA-256 of names and bytes of all `*.py` files below a folder, sorted.

    A link counts by where it points; what it points to counts only inside the folder.

    Raises:
        PolicyError: the files are too large together, or cannot be read.
    """
    root, total = folder.resolve(), 0
    digest = hashlib.sha256()
    try:
        for path in _python_files(root):
            target = os.fsencode(path.readlink()) if path.is_symlink() else b""
            data = b""
            if path.is_file() and path.resolve().is_relative_to(root):
                total += path.stat().st_size
                if total > CODE_LIMIT:
                    raise PolicyError(
                        f"{folder}: the Python files below the card are over "
                        f"{CODE_LIMIT // 2**20} MiB, and all count for the policy's identity",
                        fix="put the card and its code into a folder of their own",
                    )
                data = path.read_bytes()
            for part in (os.fsencode(path.relative_to(root).as_posix()), target, data):
                digest.update(len(part).to_bytes(8, "big") + part)
    except OSError as error:
        raise PolicyError(
            f"{error.filename}: the policy's code cannot be read: {error.strerror}",
            fix="make it readable: it counts for the policy's identity",
        ) from None
    return digest.hexdigest()


def _python_files(root: Path) -> list[Path]:
    """Return all files that end in `.py`, and all links to folders, which are not entered."""
    found: list[Path] = []
    for folder, folders, files in os.walk(root, onerror=_raise):
        found += [Path(folder, name) for name in files if name.endswith(".py")]
        found += [path for name in folders if (path := Path(folder, name)).is_symlink()]
    return sorted(found, key=lambda path: os.fsencode(path.relative_to(root).as_posix()))


def _raise(error: OSError) -> None:
    raise error
