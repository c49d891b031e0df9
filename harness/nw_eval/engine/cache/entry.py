"""One entry of the cache: a folder with a trial's row and its log.

    row.json    {"entry": 1, "key": ..., "log": {"bytes": ..., "sha256": ...}, "row": {...}, "sum"}
    log.mcap    a copy of the run's; runs that take the trial over have it as a link

It appears under its name whole or not at all. Nothing in it is believed: the sums of both files,
the key and the row are checked whenever it is read, and what fails is no entry. Nothing is fsynced:
what a power cut tears is no entry either.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
import stat
from collections.abc import Generator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from hashlib import file_digest
from io import BufferedReader
from pathlib import Path
from tempfile import mkdtemp
from typing import Any, cast

from nw_eval.engine.cache.key import FORMAT
from nw_eval.results.row import Row, from_dict, to_dict
from nw_eval.results.seal import seal, unseal

_ROW, _LOG = "row.json", "log.mcap"
_MOST = 2**20
"""Bytes of a row.json that is read; honest ones have about two thousand."""
# A link leads out of the folder, and a pipe may never end.
_PLAIN = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK
_FOLDER = os.O_RDONLY | os.O_NOFOLLOW | os.O_DIRECTORY

NO_ENTRY = (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError)
"""What reading raises where there is no entry that can be used."""


@dataclass(frozen=True, kw_only=True)
class CacheEntry:
    """A trial that has run: its row as it was then, and what its log must be."""

    path: Path
    row: Row
    log_bytes: int
    log_sha256: str

    def link_log(self, to: Path) -> None:
        """Put the log in a place, as a link to the entry's own file, or a copy on another disk.

        What was there is replaced, never written to.

        Raises:
            OSError, ValueError: it is not what was kept, or the place cannot be written.
        """
        to.parent.mkdir(parents=True, exist_ok=True)
        beside = to.with_name(f"{to.name}.cached")
        beside.unlink(missing_ok=True)
        try:
            with _opened(self.path) as folder:
                _link(_LOG, beside, folder)
            self._check(_sum_of(beside))
            to.unlink(missing_ok=True)  # To rename a file to a link of its own does nothing.
            beside.replace(to)
        except BaseException:
            with suppress(OSError):
                beside.unlink(missing_ok=True)
            raise

    def check_log(self) -> None:
        """Read the log.

        Raises:
            OSError, ValueError: it is not what was kept.
        """
        with _opened(self.path) as folder:
            self._check(_sum_of(_LOG, folder))

    def _check(self, found: tuple[int, str]) -> None:
        if found != (self.log_bytes, self.log_sha256):
            raise ValueError("the log is not what was kept")

    def touch(self) -> None:
        """Remember that the entry has been of use."""
        with suppress(OSError):
            os.utime(self.path)


def read_entry(path: Path) -> CacheEntry:
    """Return the entry of a folder, whose name is its key. Its log is not looked at.

    Raises:
        NO_ENTRY: it is none, or damaged, or another version's, or another trial's.
    """
    with _opened(path) as folder, _plain(_ROW, folder) as stream:
        data = stream.read(_MOST)
    saved = json.loads(unseal(data)[0])
    if saved["entry"] != FORMAT or saved["key"] != path.name:
        raise ValueError("it is of another version, or of another trial")
    log, row = cast("dict[str, Any]", saved["log"]), from_dict(saved["row"])
    if row.mcap_sha256 not in {"", log["sha256"]}:
        raise ValueError("its log was damaged before it was kept")
    return CacheEntry(
        path=path,
        row=row,
        log_bytes=log["bytes"],
        log_sha256=log["sha256"],
    )


def write_entry(path: Path, row: Row, log: Path) -> None:
    """Keep a trial's row and a copy of its log; whatever was there goes.

    A copy: the run's own file can be written by the processes that run trials, and may be a
    stranger's to tamper with.

    Args:
        path: the entry's folder, named by its key.
        row: as the run has it.
        log: the finished log.

    Raises:
        OSError: it cannot be kept.
        ValueError: the log is not a plain file.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = Path(mkdtemp(dir=path.parent, prefix="."))
    try:
        _copy(log, beside / _LOG)
        size, digest = _sum_of(beside / _LOG)
        saved = {
            "entry": FORMAT,
            "key": path.name,
            "log": {"bytes": size, "sha256": digest},
            "row": to_dict(row),
        }
        text = json.dumps(saved, separators=(",", ":"), allow_nan=False)
        (beside / _ROW).write_text(seal(text)[0], encoding="utf-8")
        remove(path)
        try:
            beside.rename(path)
        except OSError as error:
            if error.errno not in {errno.EEXIST, errno.ENOTEMPTY}:
                raise  # Otherwise another process was faster, with an entry as good.
    finally:
        shutil.rmtree(beside, ignore_errors=True)


def remove(path: Path) -> None:
    """Remove an entry, or whatever has its name; readers find all of it or nothing.

    Raises:
        OSError: it cannot be removed.
    """
    if not os.path.lexists(path):
        return
    gone = Path(mkdtemp(dir=path.parent, prefix="."))
    try:
        path.rename(gone / "gone")
    except FileNotFoundError:
        pass  # Another process was faster.
    finally:
        shutil.rmtree(gone, ignore_errors=True)


@contextmanager
def _opened(path: Path) -> Generator[int]:
    """Open an entry's folder, so that its files are those of one and the same entry."""
    handle = os.open(path, _FOLDER)
    try:
        yield handle
    finally:
        os.close(handle)


@contextmanager
def _plain(path: Path | str, folder: int | None = None) -> Generator[BufferedReader]:
    """Open a plain file.

    Raises:
        OSError: it is a link, or cannot be read.
        ValueError: it is no plain file.
    """
    with os.fdopen(os.open(path, _PLAIN, dir_fd=folder), "rb") as stream:
        if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
            raise ValueError("it is no plain file")
        yield stream


def _link(source: Path | str, to: Path, folder: int | None = None) -> None:
    """Give a file another name, or copy it to another disk."""
    try:
        os.link(source, to, src_dir_fd=folder, follow_symlinks=False)
    except FileNotFoundError:
        raise
    except OSError:  # Another disk, or too many names.
        _copy(source, to, folder)


def _copy(source: Path | str, to: Path, folder: int | None = None) -> None:
    with _plain(source, folder) as stream, to.open("xb") as copy:
        shutil.copyfileobj(stream, copy)


def _sum_of(path: Path | str, folder: int | None = None) -> tuple[int, str]:
    """Return size and hex sha256 of a plain file."""
    with _plain(path, folder) as stream:
        return os.fstat(stream.fileno()).st_size, file_digest(stream, "sha256").hexdigest()
