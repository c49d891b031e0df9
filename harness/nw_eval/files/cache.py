"""The user's cache folder, and files that appear in it whole or not at all and are checked.

A sealed file is its content and, behind it, the content's SHA-256 and a word of ours. Whoever maps
one is given the content only if it is what was written: disks and memory flip bits, copies stop in
the middle, and a damaged splat would change results without a word. The seal is against damage; it
is no signature, whoever may write the file can seal it.
"""

from __future__ import annotations

import hashlib
import mmap
import os
import stat
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import NamedTemporaryFile

from nw_eval.errors import StoreError

_WORD = b"\nnw-eval seal 1\n"
_SEAL = hashlib.sha256().digest_size + len(_WORD)

_mapped: dict[Path, tuple[tuple[int, ...], memoryview]] = {}
"""What this process has mapped and checked. As long as it is the same file, the same mapping serves
again: bits that flip under a mapping are beyond what can be checked."""


class DamagedError(ValueError):
    """A sealed file is cut short, changed, or was never sealed; the message says which."""


def cache_dir(*parts: str) -> Path:
    """Return (and create) a folder of the cache.

    `NW_EVAL_CACHE` overrides the place; otherwise `$XDG_CACHE_HOME/nw-eval`, `~/.cache/nw-eval`.

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
    """Return (and create) a folder of the cache into which nobody but this user can write.

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
    """Check that nobody but this user can write into a folder.

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
                fault = f"lies in {parent}, where everybody may exchange it"
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


@contextmanager
def atomic_path(path: Path) -> Generator[Path]:
    """Give a temporary path beside `path`; rename it into place on success, remove it on failure.

    Two processes that write the same file at once both succeed; readers see one of the two whole.

    Raises:
        StoreError: the file cannot be written.
    """
    temporary: Path | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with NamedTemporaryFile(
            dir=path.parent, prefix=f".{path.name[:100]}.", suffix=path.suffix, delete=False
        ) as handle:
            temporary = Path(handle.name)
        # Temporary files are private; results are as readable as whatever else the user writes.
        temporary.chmod(0o666 & ~_UMASK)
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
    with path.open("rb") as file:
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


def _root() -> Path:
    root = os.environ.get("NW_EVAL_CACHE")
    if root is not None:
        return Path(root)
    base = os.environ.get("XDG_CACHE_HOME")
    try:
        return Path(base or Path.home() / ".cache") / "nw-eval"
    except RuntimeError:  # A container's user may have neither name nor home.
        raise StoreError(
            "this user has no home folder to keep the cache in", fix="set NW_EVAL_CACHE to a folder"
        ) from None


def _unwritable(path: Path, error: OSError) -> StoreError:
    fix = "free disk space or choose another folder with --out"
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
