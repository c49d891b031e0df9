"""Folders that a user names for a result: whole or not at all, and no trace of a refused call."""

from __future__ import annotations

import errno
import os
from collections.abc import Generator
from contextlib import contextmanager, suppress
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

from nw_eval.errors import NwEvalError, StoreError, UsageError
from nw_eval.files.cache import is_full
from nw_eval.files.inside import what_is

_FIX = "name another folder"
_NO_NAME = (errno.ENAMETOOLONG, errno.ENOTDIR, errno.EINVAL, errno.ELOOP)
"""What systems answer to a path that nothing can have."""


def check_place(out: Path) -> None:
    """Check that a folder can be at a path: all above it is folders, or can be made.

    Raises:
        UsageError: a file is above it, or `..` follows a folder that is not there.
    """
    for above, below in pairwise((*reversed(out.parents), out)):
        if what_is(above) == "folder":
            continue
        if os.path.lexists(above):
            raise UsageError(f"no folder can be made at {out}: {above} is no folder", fix=_FIX)
        if below.name == "..":
            raise UsageError(
                f"no folder can be made at {out}: there is no {above}",
                fix="write the path without `..`",
            )


def check_new(out: Path, *, fix: str = _FIX) -> None:
    """Check that nothing is at a path, and that a folder can be.

    Args:
        out: the path.
        fix: what to do if something is there.

    Raises:
        UsageError: something is there, or no folder can be.
    """
    check_place(out)
    if os.path.lexists(out):
        raise UsageError(f"{out} is there already", fix=fix)


@contextmanager
def new_folder(out: Path, *, called: Path | None = None) -> Generator[Path]:
    """Give a folder to write to, of the same name, which is at `out` on success.

    Args:
        out: where nothing may be; folders above it are made, and go again on failure.
        called: what errors call the folder that is written to: the one that its files come from.
            None = `out`.

    Raises:
        UsageError: as `check_new`.
        StoreError: it cannot be written.
    """
    check_new(out)
    staged = None
    try:
        with made_folder(out.parent), TemporaryDirectory(dir=out.parent, prefix=".new-") as given:
            staged = Path(given) / out.name
            staged.mkdir()
            yield staged
            staged.rename(out)
    except OSError as error:
        raise unwritable(out, error) from error
    except NwEvalError as error:
        if staged is not None:  # No user knows it, and it is gone.
            error.rename(str(staged), str(called or out))
        raise


@contextmanager
def made_folder(folder: Path) -> Generator[None]:
    """Make a folder and all above it; on failure those that are new and empty go again.

    Raises:
        OSError: it cannot be made.
    """
    new = [one for one in (folder, *folder.parents) if what_is(one) == "nothing"]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException:
        for one in new:
            with suppress(OSError):
                one.rmdir()
        raise


def unwritable(out: Path, error: OSError) -> UsageError | StoreError:
    """Return the error of a folder that cannot be written."""
    message = f"cannot write {out}: {error.strerror or error}"
    if error.errno in _NO_NAME:
        return UsageError(message, fix=_FIX)
    fix = "choose another folder"
    return StoreError(message, fix=f"free disk space, or {fix}" if is_full(error) else fix)
