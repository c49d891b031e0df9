"""The user's cache folder, and files that appear in it whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from tempfile import NamedTemporaryFile


def cache_dir(*parts: str) -> Path:
    """Return (and create) a folder of the cache.

    `NW_EVAL_CACHE` overrides the place; otherwise `$XDG_CACHE_HOME/nw-eval`, `~/.cache/nw-eval`.
    """
    root = os.environ.get("NW_EVAL_CACHE")
    if root is None:
        base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
        root = str(Path(base) / "nw-eval")
    folder = Path(root, *parts)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _umask() -> int:
    """Return the process's umask, which can be read only by setting it."""
    mask = os.umask(0o077)
    os.umask(mask)
    return mask


_UMASK = _umask()  # Once, while the process has one thread.


@contextmanager
def atomic_path(path: Path) -> Generator[Path]:
    """Give a temporary path beside `path`; rename it into place on success, remove it on failure.

    Two processes that write the same file at once both succeed; readers see one of the two whole.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with NamedTemporaryFile(
        dir=path.parent, prefix=f".{path.name}.", suffix=path.suffix, delete=False
    ) as handle:
        temporary = Path(handle.name)
    try:
        # Temporary files are private; results are as readable as whatever else the user writes.
        temporary.chmod(0o666 & ~_UMASK)
        yield temporary
        with temporary.open("rb") as written:
            os.fsync(written.fileno())
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
