"""How kernels are compiled, and where the compiled code is kept.

Numba's cache looks at the file of the function that it compiles and at no file that this one
imports from: an edit in the vector layer would leave a stale blend in the cache. Therefore the
cache folder carries a hash of the source of every kernel file.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, TypeVar

import numba
import numba.core.config

from nw_eval.cache import cache_dir

Function = TypeVar("Function", bound=Callable[..., Any])


def _hash_sources(folder: Path) -> str:
    digest = hashlib.sha256(numba.__version__.encode())
    for path in sorted(folder.glob("*.py")):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


KERNEL_VERSION = _hash_sources(Path(__file__).parent)
"""Changes whenever any kernel file or Numba itself changes."""


def kernel(function: Function) -> Function:
    """Compile at first call, keep the machine code in the user's cache, release the GIL.

    Arithmetic is IEEE float32 as written, fused multiply-add only where `fma` is called: the same
    pixel gets the same bits whatever the threads or the pixel set around it, and on every machine
    that has a fused multiply-add (measured: AVX2 and AVX-512 agree).
    """
    return _compile(function, inline="never")


def inlined(function: Function) -> Function:
    """Compile as a part of the kernels that call it."""
    return _compile(function, inline="always", cache=False)


def _compile(
    function: Function, *, inline: Literal["always", "never"], cache: bool = True
) -> Function:
    config: Any = numba.core.config
    previous = config.CACHE_DIR
    config.CACHE_DIR = str(cache_dir("numba", KERNEL_VERSION)) if cache else previous
    try:
        compiler: Any = numba.njit(
            nogil=True, boundscheck=False, error_model="numpy", cache=cache, inline=inline
        )
        return compiler(function)
    finally:
        config.CACHE_DIR = previous
