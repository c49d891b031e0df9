"""A lock that processes of one machine share, and that none of them can take into its grave."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from nw_eval.errors import StoreError


@contextmanager
def locked(file: Path) -> Generator[None]:
    """Wait for a file's lock, and hold it.

    The kernel holds it for this process alone, whatever children it starts: it ends with the
    process, however that ends.

    Raises:
        StoreError: the file cannot be made.
    """
    import fcntl

    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        handle = file.open("a", encoding="utf-8")
    except OSError as error:
        raise StoreError(
            f"cannot make {file}: {error.strerror}",
            fix="choose another folder with --nw-report-dir",
        ) from error
    with handle:
        fcntl.lockf(handle, fcntl.LOCK_EX)
        yield
