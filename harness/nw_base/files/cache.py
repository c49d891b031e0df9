"""How every file is written, the user's cache folder, and files in it that are checked.

`atomic_path` writes every output of nw-eval; `tests/base/files/test_outputs.py` holds that nothing
else opens a file for writing, but for the few that it lists. `new_folder` gives a folder that a
user names for a result: whole or not at all, and no trace of a refused call.

A sealed file is its content and, behind it, the content's SHA-256 and a word of ours. Whoever maps
one is given the content only if it is what was written: disks and memory flip bits, copies stop in
the middle, and a damaged splat would change results without a word. The seal is against damage; it
is no signature, whoever may write the file can seal it.
"""

from __future__ import annotations

import errno
import hashlib
import mmap
import os
import select
import stat
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager, suppress
from itertools import pairwise
from pathlib import Path
from tempfile import NamedTemporaryFile, TemporaryDirectory

from nw_base.errors import NwEvalError, StoreError, UsageError
from nw_base.files.inside import regular, what_is

_WORD = b"\nnw-eval seal 1\n"
_SEAL = hashlib.sha256().digest_size + len(_WORD)

_FILE, _STREAM = "a file", "a device or a pipe"
_REFUSED = ("a link", "a folder", "a socket", "a disk")
_LINKS = 40  # in a row, as many as Linux follows
_READER_COMES, _READER_READS = 10.0, 600.0  # s that a pipe's reader may take

_mapped: dict[Path, tuple[tuple[int, ...], memoryview]] = {}
"""What this process has mapped and checked. As long as it is the same file, the same mapping serves
again: bits that flip under a mapping are beyond what can be checked."""


class DamagedError(ValueError):
    """A sealed file is cut short, changed, or was never sealed; the message says which."""


def cache_dir(*parts: str) -> Path:
    """Return (and create) a folder of the cache.

    `NW_EVAL_CACHE` overrides the path; otherwise `$XDG_CACHE_HOME/nw-eval`, `~/.cache/nw-eval`.

    Raises:
        StoreError: it cannot be made.
    """
    folder = _root().joinpath(*parts)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _unwritable(folder, error) from error
    return folder


def private_dir(*parts: str) -> Path:
    """Return (and create) a folder of the cache into which only this user can write.

    Raises:
        StoreError: it cannot be made; it is a link or another user's, or others may write into it
            or exchange it.
    """
    folder = cache_dir(*parts[:-1]) / parts[-1]
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        check_private(folder)
    except OSError as error:
        raise _unwritable(folder, error) from error
    return folder


def check_private(folder: Path) -> None:
    """Check that only this user can write into a folder.

    Raises:
        StoreError: it is a link or another user's, or others may write into it or exchange it.
        OSError: it cannot be looked at.
    """
    facts = folder.lstat()
    fault = None
    if not stat.S_ISDIR(facts.st_mode):
        fault = "is a link or no folder"
    elif facts.st_uid != os.geteuid():
        fault = f"belongs to user {facts.st_uid}, not to {os.geteuid()}"
    elif facts.st_mode & 0o022:
        fault = "may be written by others"
    else:
        for parent in folder.resolve().parents:
            mode = parent.stat().st_mode
            if mode & stat.S_IWOTH and not mode & stat.S_ISVTX:
                fault = f"lies in {parent}, where any user may replace it"
    if fault is not None:
        raise StoreError(
            f"the cache folder {folder} {fault}",
            fix="remove it, or set NW_EVAL_CACHE to a folder of your own",
        )


def sync_folder(folder: Path) -> None:
    """Wait until a folder's list of names is on disk; systems that cannot do so are left alone."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def followed(path: Path) -> Path:
    """Return the path that an output goes to whose path the user gave: links are followed.

    A link may lead to nothing yet. Only what the user named is followed; `atomic_path` refuses
    links, since a link in an untrusted run folder could lead anywhere.

    Raises:
        UsageError: a folder, a socket or a disk is there, or the links form a circle.
        StoreError: it cannot be looked at.
    """
    target = path
    try:
        for _ in range(_LINKS):
            if _descriptor(target) is not None:
                return target
            if not target.is_symlink():
                break
            target = target.parent / target.readlink()
        kind = _kind(target)
    except OSError as error:
        raise _unwritable(path, error) from error
    if kind in _REFUSED:
        fault = "its links form a circle" if kind == "a link" else f"it is {kind}"
        raise UsageError(f"cannot write {path}: {fault}", fix="name a file")
    return target


def is_stream(path: Path) -> bool:
    """Return whether what is written to a path goes into a device, a pipe or an open file."""
    target = followed(path)
    return _descriptor(target) is not None or _kind(target) == _STREAM


@contextmanager
def atomic_path(path: Path) -> Generator[Path]:
    """Give a temporary path to write to; what was written becomes the file at `path` on success.

    A regular file is replaced as a whole by a rename, and keeps its mode and, where the system
    allows it, its owner; a new one has the mode 0666 without the umask. Into a device, a pipe or an
    open file of this process (`/dev/fd/3`) what was written is copied. Anything else stays as it
    is: nothing is replaced by something of another kind. On failure the old file is untouched.

    Two processes that write the same file at once both succeed; readers see one of the two whole.

    Raises:
        StoreError: the file cannot be written, or a link, a folder, a socket or a disk is there.
    """
    try:
        descriptor, kind = _descriptor(path), _kind(path)
    except OSError as error:
        raise _unwritable(path, error) from error
    if descriptor is not None or kind == _STREAM:
        with _poured(path, descriptor) as temporary:
            yield temporary
        return
    if kind not in {None, _FILE}:
        raise StoreError(f"cannot write {path}: it is {kind}", fix="remove it, or name another")
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with NamedTemporaryFile(
            dir=path.parent, prefix=f".{path.name[:100]}.", suffix=path.suffix, delete=False
        ) as handle:
            temporary = Path(handle.name)
        _take_over_rights(path, temporary)
        yield temporary
        with temporary.open("rb") as written:
            os.fsync(written.fileno())
        temporary.replace(path)
        sync_folder(path.parent)
    except BaseException as error:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise _unwritable(path, error) from error
        raise


def open_own(path: Path, flags: int) -> int:
    """Open a file of a run's folder for appending or changing; return its descriptor.

    As `os.open`, but nothing is followed or waited for: an untrusted folder may hold links and
    pipes. A new file has the mode 0666 without the umask.

    Raises:
        OSError: as `os.open`, or no regular file is there.
    """
    handle = os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o666)
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise OSError(errno.EINVAL, "it is not a regular file", str(path))
    return handle


@contextmanager
def sealed_path(path: Path) -> Generator[Path]:
    """As `atomic_path`, and seal what was written.

    Raises:
        StoreError: the file cannot be written.
    """
    with atomic_path(path) as temporary:
        yield temporary
        with temporary.open("r+b") as file:
            digest = hashlib.file_digest(file, "sha256").digest()
            file.write(digest + _WORD)


def read_sealed(path: Path) -> memoryview:
    """Map a sealed file and return its content, read-only.

    Raises:
        DamagedError: it is not what was written.
        OSError: there is none, or it cannot be read.
    """
    with regular(path).open("rb") as file:
        facts = os.fstat(file.fileno())
        identity = (facts.st_dev, facts.st_ino, facts.st_size, facts.st_mtime_ns)
        known = _mapped.get(path)
        if known is not None and known[0] == identity:
            return known[1]
        if facts.st_size < _SEAL:
            raise DamagedError("it is cut short")
        data = memoryview(mmap.mmap(file.fileno(), facts.st_size, access=mmap.ACCESS_READ))
    content, seal = data[:-_SEAL], bytes(data[-_SEAL:])
    if not seal.endswith(_WORD):
        raise DamagedError("its end is missing or changed, or another version wrote it")
    if seal != hashlib.sha256(content).digest() + _WORD:
        raise DamagedError("its content is not what was written")
    _mapped[path] = identity, content
    return content


def _kind(path: Path) -> str | None:
    """Return what is at a path, in words; None = nothing is."""
    try:
        mode = path.lstat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return None
    if stat.S_ISREG(mode):
        return _FILE
    if stat.S_ISCHR(mode) or stat.S_ISFIFO(mode):
        return _STREAM
    if stat.S_ISLNK(mode):
        return "a link"
    return "a folder" if stat.S_ISDIR(mode) else "a disk" if stat.S_ISBLK(mode) else "a socket"


def _descriptor(path: Path) -> int | None:
    """Return which open file of this process a path such as `/dev/fd/3` names, if it does."""
    if not path.name.isdecimal():
        return None
    is_open = os.path.realpath(path.parent) == f"/proc/{os.getpid()}/fd"
    return int(path.name) if is_open else None


def _take_over_rights(path: Path, temporary: Path) -> None:
    """Give a file the rights of the one that it will replace; temporary files are private."""
    try:
        old = path.lstat()
    except FileNotFoundError:
        temporary.chmod(0o666 & ~_UMASK)
        return
    own = temporary.lstat()
    if (old.st_uid, old.st_gid) != (own.st_uid, own.st_gid):
        with suppress(OSError):  # Only root may give files away.
            os.chown(temporary, old.st_uid, old.st_gid)
    temporary.chmod(old.st_mode & 0o777)


@contextmanager
def _poured(path: Path, descriptor: int | None) -> Generator[Path]:
    """As `atomic_path`, for what can only be written from its beginning to its end.

    Some writers go back to where they began, so a file is written first.
    """
    try:
        with TemporaryDirectory(prefix="nw-eval-") as folder:
            temporary = Path(folder, f"output{path.suffix}")
            temporary.touch()
            yield temporary
            handle = _opened(path) if descriptor is None else os.dup(descriptor)
            try:
                if descriptor in {1, 2}:  # What was printed before comes before.
                    sys.stdout.flush()
                _copy(temporary, handle)
            finally:
                os.close(handle)
    except OSError as error:
        raise _unwritable(path, error) from error


def _opened(path: Path) -> int:
    """Open a device or a pipe; wait some seconds for a program that reads the pipe.

    Raises:
        OSError: it cannot be opened, or it has no reader.
    """
    deadline = time.monotonic() + _READER_COMES
    while True:
        try:
            handle = os.open(path, os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_NOFOLLOW)
        except OSError as error:
            if error.errno != errno.ENXIO:
                raise
            if time.monotonic() > deadline:
                raise OSError(errno.ENXIO, "no program reads this pipe") from None
            time.sleep(0.05)
        else:
            os.set_blocking(handle, True)
            return handle


def _copy(source: Path, handle: int) -> None:
    """Write a file's content; a reader that does not read is not waited for without end.

    Raises:
        OSError: it cannot be written.
    """
    ready = select.poll()
    ready.register(handle, select.POLLOUT)
    with source.open("rb") as content:
        while piece := content.read(select.PIPE_BUF):  # A pipe that is ready takes so much at once.
            rest = memoryview(piece)
            while rest:
                if not ready.poll(1000.0 * _READER_READS):
                    raise OSError(errno.ETIMEDOUT, "its reader does not read")
                rest = rest[os.write(handle, rest) :]


def _root() -> Path:
    if root := os.environ.get("NW_EVAL_CACHE"):  # Empty is as good as unset, as with XDG's.
        return Path(root)
    base = os.environ.get("XDG_CACHE_HOME")
    try:
        return Path(base or Path.home() / ".cache") / "nw-eval"
    except RuntimeError:  # A container's user may have neither name nor home.
        raise StoreError(
            "this user has no home folder to keep the cache in", fix="set NW_EVAL_CACHE to a folder"
        ) from None


def is_full(error: OSError) -> bool:
    """Return whether there is no room: no other error goes away if disk space is freed."""
    return error.errno in {errno.ENOSPC, errno.EDQUOT}


def _unwritable(path: Path, error: OSError) -> StoreError:
    fix = "choose another folder with --out"
    if is_full(error):
        fix = f"free disk space or {fix}"
    with suppress(StoreError):
        root = _root()
        if path.is_relative_to(root):
            fix = f"free space in {root}, or set NW_EVAL_CACHE to a folder that can be written"
    return StoreError(f"cannot write {path}: {error.strerror or error}", fix=fix)


def _umask() -> int:
    """Return the process's umask, which can be read only by setting it."""
    mask = os.umask(0o077)
    os.umask(mask)
    return mask


_UMASK = _umask()  # Once, while the process has one thread.


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
            raise UsageError(f"no folder can be made at {out}: {above} is not a folder", fix=_FIX)
        if below.name == "..":
            raise UsageError(
                f"no folder can be made at {out}: there is no {above}",
                fix="write the path without `..`",
            )


def made_place(out: Path) -> None:
    """Make a folder for results, unless it is there.

    Raises:
        UsageError: a file or a link to nothing is there, or as `check_place`.
        StoreError: it cannot be made.
    """
    check_place(out)
    if os.path.lexists(out) and what_is(out) != "folder":
        raise UsageError(f"cannot write {out}: it is not a folder", fix=_FIX)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable(out, error) from error


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
