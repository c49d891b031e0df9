"""How kernels are compiled, and where the compiled code is kept.

Numba's cache looks at the file of the function that it compiles and at no file that this one
imports from: an edit in the vector layer would leave a stale blend in the cache. Therefore the
cache folder carries a hash of the source of every kernel file.
"""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, TypeVar

import llvmlite
import numba
import numpy as np

from nw_eval.splat.kernels.kept import kept_code

Function = TypeVar("Function", bound=Callable[..., Any])


def _hash_sources(folder: Path) -> str:
    versions = (platform.python_version(), numba.__version__, llvmlite.__version__, np.__version__)
    digest = hashlib.sha256(" ".join(versions).encode())
    for path in sorted(folder.glob("*.py")):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


KERNEL_VERSION = _hash_sources(Path(__file__).parent)
"""Changes whenever any kernel file or what compiles it changes."""


def kernel(function: Function) -> Function:
    """Compile at first call, keep the machine code in the user's cache, release the GIL.

    Arithmetic is IEEE float32 as written, fused multiply-add only where `fma` is called: the same
    pixel gets the same bits whatever the threads or the pixel set around it, and on every machine
    that has a fused multiply-add (measured: AVX2 and AVX-512 agree).
    """
    compiled = _compile(function, inline="never")
    cache = kept_code(function, KERNEL_VERSION)
    if cache is not None:
        compiled._cache = cache  # noqa: SLF001 - Numba has no public way to bring one's own cache.
    return compiled


def inlined(function: Function) -> Function:
    """Compile as a part of the kernels that call it."""
    return _compile(function, inline="always")


def _compile(function: Callable[..., Any], *, inline: Literal["always", "never"]) -> Any:
    compiler: Any = numba.njit(nogil=True, boundscheck=False, error_model="numpy", inline=inline)
    return compiler(function)
