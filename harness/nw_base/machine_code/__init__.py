"""Functions compiled to machine code by Numba, and where the code is kept.

Numba's cache looks at the file of the function that it compiles and at no file that this one
imports from: an edit in the vector layer would leave a stale blend in the cache. Therefore the
name of a file there carries a hash of every source in the kernel's folder, and of `nw_base.simd`.

Numba reads what it has kept with pickle, which runs whatever is in it, and runs the machine code: a
file that another user wrote is an attack, one that is cut short a crash. So the folder is private,
and a file is given to Numba only if it is what was written; another one is removed, and its kernel
is compiled again. That is against damage and against other users. Who has this user's rights needs
no cache to run code. Where nothing can be kept or read, as in a fenced process, kernels are
compiled in memory.

That all kernels of a folder have been compiled for a purpose is remembered by a mark. Each kernel
has its file in the cache, and which files there should be is not known before they are called. The
mark says only that it takes no time to call them: one that is wrong costs some.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import platform
import shutil
import tempfile
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, Literal, TypeVar

import llvmlite
import numba
import numpy as np
from llvmlite import binding
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile
from numba.core.ccallback import CFunc

from nw_base.errors import StoreError
from nw_base.files.cache import DamagedError, check_private, private_dir, read_sealed, sealed_path

Function = TypeVar("Function", bound=Callable[..., Any])

_AS_WRITTEN: dict[str, Any] = {"boundscheck": False, "error_model": "numpy"}


_VECTORS = Path(__file__).parents[1] / "simd"


def hash_sources(folder: Path) -> str:
    """Return what changes whenever a source of kernels changes, or what compiles it.

    Args:
        folder: of the kernels. The vectors that all kernels are made of count, too.
    """
    versions = (platform.python_version(), numba.__version__, llvmlite.__version__, np.__version__)
    digest = hashlib.sha256(" ".join(versions).encode())
    for path in (*sorted(folder.glob("*.py")), *sorted(_VECTORS.glob("*.py"))):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


def kernel(function: Function) -> Function:
    """Compile at first call, keep the machine code in the user's cache, release the GIL.

    Arithmetic is IEEE float32 as written, fused multiply-add only where `fma` is called: the same
    pixel gets the same bits whatever the threads or the pixel set around it, and on every machine
    that has a fused multiply-add (measured: AVX2 and AVX-512 agree).
    """
    compiled = _compile(function, inline="never")
    kept = _cache_of(function)
    if kept is not None:
        compiled._cache = kept  # noqa: SLF001 - Numba has no public way to bring one's own cache.
    return compiled


def c_function(function: Callable[..., Any], arguments: tuple[Any, ...], returns: Any) -> Any:
    """Compile as a C function and keep its machine code like a kernel's.

    Args:
        function: what it closes over is frozen into it, and tells its code from other code.
        arguments: Numba's types.
        returns: Numba's type.

    Returns:
        An object with the `address` of the function, which lives as long as the object.
    """
    compiled: Any = CFunc(function, (arguments, returns), locals={}, options=_AS_WRITTEN)
    compiled._cache = _cache_of(function) or compiled._cache  # noqa: SLF001 - as in `kernel`.
    compiled.compile()
    return compiled


def inlined(function: Function) -> Function:
    """Compile as a part of the kernels that call it."""
    return _compile(function, inline="always")


def part(function: Function) -> Function:
    """Compile a large function that kernels call."""
    return _compile(function, inline="never")


def _cache_of(function: Callable[..., Any]) -> FunctionCache | None:
    return kept_code(function, _version(Path(function.__code__.co_filename).parent))


@cache
def _version(folder: Path) -> str:
    return hash_sources(folder)


def _compile(function: Callable[..., Any], *, inline: Literal["always", "never"]) -> Any:
    compiler: Any = numba.njit(nogil=True, inline=inline, **_AS_WRITTEN)
    return compiler(function)


_LENT = "NW_EVAL_KERNELS"
"""The temporary folder that the first process of a run lends to its workers."""


def kept_code(function: Callable[..., Any], version: str) -> FunctionCache | None:
    """Return the cache of one kernel, for Numba; None where nothing can be kept.

    Args:
        function: the kernel before it is compiled.
        version: names the sources and what compiles them. Numba itself tells types of arguments
            and kinds of processor apart.
    """
    folder, _ = _folder()
    return None if folder is None else _Kept(function, folder, version)


def folder_note() -> str | None:
    """Return why this process keeps code elsewhere than in the cache; None if it does not."""
    return _folder()[1]


@cache
def _folder() -> tuple[Path | None, str | None]:
    try:
        return private_dir("kernels"), None
    except StoreError as error:
        reason = str(error)
    with suppress(OSError, StoreError):
        lent = Path(os.environ.get(_LENT) or tempfile.mkdtemp(prefix="nw-eval-kernels-"))
        check_private(lent)
        if _LENT not in os.environ:
            os.environ[_LENT] = str(lent)
            atexit.register(shutil.rmtree, lent, ignore_errors=True)
        return lent, f"kernels are compiled for this run only: {reason}"
    return None, f"kernels are compiled in every process: {reason}"


class _Locator:
    """What Numba asks for the location of a function's code."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._py_file = function.__code__.co_filename
        self._line = function.__code__.co_firstlineno

    @classmethod
    def from_function(cls, function: Callable[..., Any], _file: str) -> _Locator:
        return cls(function)

    def ensure_cache_path(self) -> None:
        pass

    def get_cache_path(self) -> str:
        return ""

    def get_source_stamp(self) -> str:
        return ""

    def get_disambiguator(self) -> str:
        return str(self._line)


class _Serialised(CompileResultCacheImpl):
    """How Numba turns compiled code into bytes and back."""

    _locator_classes = [_Locator]  # noqa: RUF012 - Numba's name and type.


class _Kept(FunctionCache):
    """The kept code of one kernel."""

    _impl_class = _Serialised

    def __init__(self, function: Callable[..., Any], folder: Path, version: str) -> None:
        super().__init__(function)
        self._cache_path = str(folder)
        name = f"{self._impl.filename_base}.{version}"
        self._cache_file = _Files(folder, name)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep one compiled signature, if it can be kept."""
        with suppress(OSError, StoreError):
            super().save_overload(sig, data)


class _Files(IndexDataCacheFile):
    """One sealed file for each signature of a kernel and kind of processor, and no index."""

    def __init__(self, folder: Path, name: str) -> None:
        super().__init__(str(folder), name, "")
        self._folder = folder
        self._name = name

    def flush(self) -> None:
        for path in self._folder.glob(f"{self._name}.*.nbc"):
            path.unlink(missing_ok=True)

    def save(self, key: Any, data: Any) -> None:
        self._save_data(self._file(key), (key, data))

    def load(self, key: Any) -> Any:
        path = self._folder / self._file(key)
        try:
            read_sealed(path)
            kept, data = self._load_data(path.name)
        except DamagedError:
            with suppress(OSError):
                path.unlink()
            return None
        except OSError:
            return None
        return data if kept == key else None

    def _file(self, key: Any) -> str:
        return f"{self._name}.{hashlib.sha256(repr(key).encode()).hexdigest()[:16]}.nbc"

    @contextmanager
    def _open_for_write(self, filepath: str) -> Generator[Any]:
        with sealed_path(Path(filepath)) as temporary, temporary.open("wb") as file:
            yield file


def is_compiled(folder: Path, purpose: str) -> bool:
    """Return whether the kernels of a folder were compiled as they are, for this processor.

    Args:
        folder: of their sources.
        purpose: what they are called with; other arguments are other machine code.
    """
    with suppress(OSError, StoreError):
        return _mark(folder, purpose).is_file()
    return False


def mark_compiled(folder: Path, purpose: str) -> None:
    """Remember that the kernels of a folder have been compiled, where anything can be kept."""
    with suppress(OSError, StoreError):
        mark = _mark(folder, purpose)
        if not mark.is_file():
            mark.touch()


def _mark(folder: Path, purpose: str) -> Path:
    known = f"{hash_sources(folder)}.{binding.get_host_cpu_name()}"
    return private_dir("kernels") / f"{folder.parent.name}-{purpose}.{known}.compiled"
