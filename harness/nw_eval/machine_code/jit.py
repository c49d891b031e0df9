"""How kernels are compiled, and where the compiled code is kept.

Numba's cache looks at the file of the function that it compiles and at no file that this one
imports from: an edit in the vector layer would leave a stale blend in the cache. Therefore the
name of a file there carries a hash of every source in the kernel's folder.
"""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, Literal, TypeVar

import llvmlite
import numba
import numpy as np
from numba.core.caching import FunctionCache
from numba.core.ccallback import CFunc

from nw_eval.machine_code.kept import kept_code

Function = TypeVar("Function", bound=Callable[..., Any])

_AS_WRITTEN: dict[str, Any] = {"boundscheck": False, "error_model": "numpy"}


def hash_sources(folder: Path) -> str:
    """Return what changes whenever a source in a folder changes, or what compiles it."""
    versions = (platform.python_version(), numba.__version__, llvmlite.__version__, np.__version__)
    digest = hashlib.sha256(" ".join(versions).encode())
    for path in sorted(folder.glob("*.py")):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


def kernel(function: Function) -> Function:
    """Compile at first call, keep the machine code in the user's cache, release the GIL.

    Arithmetic is IEEE float32 as written, fused multiply-add only where `fma` is called: the same
    pixel gets the same bits whatever the threads or the pixel set around it, and on every machine
    that has a fused multiply-add (measured: AVX2 and AVX-512 agree).
    """
    compiled = _compile(function, inline="never")
    kept = _kept(function)
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
    compiled._cache = _kept(function) or compiled._cache  # noqa: SLF001 - as in `kernel`.
    compiled.compile()
    return compiled


def inlined(function: Function) -> Function:
    """Compile as a part of the kernels that call it."""
    return _compile(function, inline="always")


def _kept(function: Callable[..., Any]) -> FunctionCache | None:
    return kept_code(function, _version(Path(function.__code__.co_filename).parent))


@cache
def _version(folder: Path) -> str:
    return hash_sources(folder)


def _compile(function: Callable[..., Any], *, inline: Literal["always", "never"]) -> Any:
    compiler: Any = numba.njit(nogil=True, inline=inline, **_AS_WRITTEN)
    return compiler(function)
