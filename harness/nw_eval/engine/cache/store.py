"""The folder of all entries: `trials/<conditions>/<key>/` in the user's cache.

Entries are found by their keys, so that nothing is read that is not asked for, and every entry is
on its own: two processes that write at once, a full disk or a crash damage none but their own. An
entry's time is that of its last use; over the limit the least recently used ones go first.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from time import time
from typing import TYPE_CHECKING, Self

from nw_eval.engine.cache.entry import NO_ENTRY, CacheEntry, read_entry, remove, write_entry
from nw_eval.errors import UsageError
from nw_eval.files.cache import private_dir

if TYPE_CHECKING:
    from nw_eval.engine.cache.key import Conditions
    from nw_eval.results.row import Row

LIMIT_GB = 5.0
"""Size that the cache may have, in GB, where `NW_EVAL_CACHE_GB` says nothing."""

_GB = 10**9
_ABANDONED = 3600.0  # s after which nobody goes on with what is half written.
_HEADROOM = 0.9  # of the limit to which it is pruned, so that not every run has to.


@dataclass(frozen=True, kw_only=True)
class Kept:
    """Something that takes up room in the cache: an entry, or what lies where one would."""

    path: Path
    bytes: int
    used: float  # s since 1970


def limit_bytes() -> int:
    """Return the size that the cache may have; 0 = there is to be none.

    Raises:
        UsageError: `NW_EVAL_CACHE_GB` is no size.
    """
    text = os.environ.get("NW_EVAL_CACHE_GB") or str(LIMIT_GB)
    try:
        size = float(text)
        if 0.0 <= size <= _GB:
            return round(size * _GB)
    except ValueError:
        pass
    raise UsageError(f"NW_EVAL_CACHE_GB is {text[:40]!r}", fix="give a size in GB; 0 keeps nothing")


class TrialStore:
    """The cache of trials.

    Args:
        folder: into which only this user can write.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @classmethod
    def of_user(cls) -> Self:
        """Open the user's own.

        Raises:
            StoreError: its folder cannot be made, or others could write into it.
        """
        return cls(private_dir("trials"))

    def find(self, conditions: Conditions, key: str) -> CacheEntry | None:
        """Return the entry of a key, if there is one that can be used."""
        try:
            return read_entry(self._path(conditions, key))
        except NO_ENTRY:
            return None

    def put(self, conditions: Conditions, key: str, row: Row, log: Path) -> None:
        """Keep a trial.

        Raises:
            OSError, ValueError: it cannot be kept.
        """
        write_entry(self._path(conditions, key), row, log)

    def void(self, conditions: Conditions) -> int:
        """Remove all entries of some conditions; return how many there were."""
        folder = self.folder / conditions.digest
        entries = list(_inside(folder))
        with suppress(OSError):
            remove(folder)
        return sum(not path.name.startswith(".") for path in entries)

    def __iter__(self) -> Iterator[Kept]:
        """Yield all that takes up room, in no order, but for what is just being written."""
        for folder in _inside(self.folder):
            for path in _inside(folder) if _is_folder(folder) else (folder,):
                with suppress(OSError):
                    used = path.lstat().st_mtime
                    if not path.name.startswith(".") or time() - used > _ABANDONED:
                        yield Kept(path=path, bytes=_size(path), used=used)

    def prune(self, limit: int) -> list[Kept]:
        """Remove what has not been used for longest, until the rest is well within a limit.

        Args:
            limit: bytes; what is within it already stays as it is.

        Returns:
            What was removed. What cannot be is left alone.
        """
        kept = sorted(self, key=lambda each: (each.used, each.path))
        size, removed = sum(each.bytes for each in kept), list[Kept]()
        wanted = size if size <= limit else _HEADROOM * limit
        for each in kept:
            if size <= wanted:
                break
            with suppress(OSError):
                remove(each.path)
                size -= each.bytes
                removed.append(each)
        for folder in _inside(self.folder):
            with suppress(OSError):
                folder.rmdir()  # Which only empty ones let one do.
        return removed

    def _path(self, conditions: Conditions, key: str) -> Path:
        return self.folder / conditions.digest / key


def _inside(folder: Path) -> Iterator[Path]:
    """Yield what lies in a folder; nothing where that cannot be looked at."""
    with suppress(OSError):
        yield from list(folder.iterdir())


def _is_folder(path: Path) -> bool:
    try:
        return stat.S_ISDIR(path.lstat().st_mode)
    except OSError:
        return False


def _size(path: Path) -> int:
    """Return the bytes of a file, or of the files of a folder; links count as what they are."""
    files = _inside(path) if _is_folder(path) else (path,)
    total = 0
    for file in files:
        with suppress(OSError):
            total += file.lstat().st_size
    return total
