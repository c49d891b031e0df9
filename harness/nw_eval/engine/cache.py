"""Results of trials that have run before, kept in the user's cache folder.

What a result depends on is one digest, its key: bytes and numbers, and never a name. Entries lie in
`trials/<conditions>/<key>/` and are found by their keys, so that nothing is read that is not asked
for, and every entry is on its own: two processes that write at once, a full disk or a crash damage
none but their own. An entry's time is that of its last use; over the limit the least recently used
ones go first. An entry is a folder with a trial's row and its log.

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
import platform
import shutil
import stat
from collections.abc import Generator, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from functools import cached_property
from hashlib import file_digest
from io import BufferedReader
from pathlib import Path
from tempfile import mkdtemp
from time import time
from typing import TYPE_CHECKING, Any, Self, cast

from nw_base.digest import digest_of
from nw_base.errors import StoreError, UsageError
from nw_base.files.cache import cache_dir, private_dir
from nw_base.trials import without_place
from nw_gate.results.row import Row, from_dict, to_dict
from nw_gate.results.seal import seal, unseal

if TYPE_CHECKING:
    from collections.abc import Mapping

    from nw_sim.rollout.job import TrialJob

LIMIT_GB = 5.0
"""Size that the cache may have, in GB, where `NW_EVAL_CACHE_GB` says nothing."""

_GB = 10**9
_ABANDONED = 3600.0  # s after which a half-written file is given up.
_HEADROOM = 0.9  # of the limit to which it is pruned, so that not every run has to.
_TRIALS = "trials"
_ROW, _LOG = "row.json", "log.mcap"
_MOST_ROW = 2**20
"""Bytes of a row.json that is read; honest ones have about two thousand."""
# A link leads out of the folder, and a pipe may never end.
_PLAIN = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK
_FOLDER = os.O_RDONLY | os.O_NOFOLLOW | os.O_DIRECTORY

NO_ENTRY = (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError)
"""What reading raises where there is no entry that can be used."""
FORMAT = 1
"""Of an entry. Those of another one are never read, and are removed as they age."""

# What names things, and what says where a trial runs, how long it may take, and where its log goes.
# Every other field counts, those that are added too. Scene, policy and checkpoint count by their
# digests.
_LABELS = frozenset({"suite", "scene", "tier", "place"})
_CIRCUMSTANCE = frozenset(
    {"trial", "scene", "policy", "policy_name", "checkpoint", "robot_folder"}
    | {"allow_code", "attachments", "mcap", "time_limit"}
)


@dataclass(frozen=True, kw_only=True)
class Kept:
    """Something that takes up room in the cache: an entry, or what lies where one would."""

    path: Path
    bytes: int
    used: float  # s since 1970


def limit_bytes() -> int:
    """Return the size that the cache may have; 0 = no cache.

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


def told_of_cache() -> str:
    """Return where a cache will be and how large, if no run has kept a result there yet.

    Empty if one has, if none is to be kept, or where there is no place for it, which is told later.

    Raises:
        UsageError: `NW_EVAL_CACHE_GB` is no size.
    """
    limit = limit_bytes() / _GB
    try:
        folder = cache_dir()
    except StoreError:
        return ""
    if not limit or (folder / _TRIALS).exists():
        return ""
    return (
        f"first run: what is built and computed is kept in {folder} for later runs (results up to "
        f"{limit:g} GB, about 15 MB for each scene, 60 MB of compiled code); NW_EVAL_CACHE names "
        "another folder, NW_EVAL_CACHE_GB another size"
    )


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
        return cls(private_dir(_TRIALS))

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


@dataclass(frozen=True, kw_only=True)
class CacheEntry:
    """A trial that has run: its row as it was then, and what its log must be."""

    path: Path
    row: Row
    log_bytes: int
    log_sha256: str

    def link_log(self, to: Path) -> None:
        """Put the log at a path, as a link to the entry's own file, or a copy on another disk.

        What was there is replaced, never written to.

        Raises:
            OSError, ValueError: it is not what was kept, or the path cannot be written.
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
        """Mark the entry as used."""
        with suppress(OSError):
            os.utime(self.path)


def read_entry(path: Path) -> CacheEntry:
    """Return the entry of a folder, whose name is its key. Its log is not looked at.

    Raises:
        NO_ENTRY: it is not an entry, is damaged, or another version's, or another trial's.
    """
    with _opened(path) as folder, _plain(_ROW, folder) as stream:
        data = stream.read(_MOST_ROW)
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

    A copy: the run's own file can be written by the processes that run trials, which may
    tamper with it.

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
        ValueError: it is not a regular file.
    """
    with os.fdopen(os.open(path, _PLAIN, dir_fd=folder), "rb") as stream:
        if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
            raise ValueError("it is not a regular file")
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


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """What all trials of a run have in common that can change a result.

    Attributes:
        policy: hex digest of card and weights, `Bundle.digest`.
        engine: `JournalHeader.engine`: versions, renderer, kind of CPU, code.
        system: what else lies beneath them, such as the C library's version.
    """

    policy: str
    engine: Mapping[str, str]
    system: Mapping[str, str]

    @cached_property
    def digest(self) -> str:
        """Hex sha256. Entries of one digest lie in one folder, and are voided together."""
        return digest_of([FORMAT, self.policy, dict(self.engine), dict(self.system)])

    def key(self, job: TrialJob) -> str:
        """Return the hex sha256 of everything that can change a trial's result, or its log."""
        trial = _without(asdict(job.trial), _LABELS)
        fields = _without(vars(job), _CIRCUMSTANCE)
        fields["task"] = without_place(job.task.model_dump())
        fields["rendering"] = job.rendering.model_dump()
        return digest_of([self.digest, trial, fields])


def system() -> dict[str, str]:
    """Return what numerical libraries stand on, beside the processor."""
    return {
        "python": platform.python_version(),
        "libc": " ".join(platform.libc_ver()),
        "architecture": platform.machine(),
    }


def _without(fields: Mapping[str, Any], names: frozenset[str]) -> dict[str, Any]:
    return {name: value for name, value in fields.items() if name not in names}
