"""Compiled Gaussians in one file, memory-mapped by every process that renders them.

The file: a first line of JSON (format, kernel layout, counts, where each array lies), padded to a
multiple of 64 bytes, then the arrays, each at a multiple of 64, then the seal of cache.py.
A file that is damaged, cut short, of another layout or of another content does not open.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nw_eval.errors import SceneError
from nw_eval.files.cache import DamagedError, read_sealed, sealed_path
from nw_eval.splat.gaussians import Gaussians
from nw_eval.splat.layout import Layout, arrange
from nw_eval.words import RASTERIZE_MODES, RasterizeMode

FORMAT = 4
"""Changes with the layout of the arrays; part of every cache key."""

SUFFIX = ".nwsplat"
"""Of our own: `.splat` is another format, which anybody reads."""

_MAGIC = "nw-eval splat store"
MARK = f'{{"magic": "{_MAGIC}"'.encode()
"""What a file begins with."""

_ALIGN = 64
_HEADER_LIMIT = 4096
_ARRAYS = {"geometry": "<f4", "dc": "<f4", "sh": "<u2", "bounds": "<f4"}


@dataclass(frozen=True, kw_only=True)
class Store:
    """Gaussians arranged for the kernels; see layout.py for the arrays.

    Attributes:
        count: Gaussians that can be seen.
        sh_count: harmonics per channel: 1, 4, 9 or 16.
        layout: the arrays, read-only.
        path: the file behind them; None when they live in memory.
        key: what was compiled, as given to `compile_store`.
        rasterize_mode: see `Gaussians`; None is drawn antialiased.
    """

    count: int
    sh_count: int
    layout: Layout
    path: Path | None
    key: str
    rasterize_mode: RasterizeMode | None = None

    @property
    def chunks(self) -> int:
        """Number of chunks."""
        return self.layout.chunks

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        return sum(array.nbytes for array in self.layout.arrays().values())


def memory_store(gaussians: Gaussians) -> Store:
    """Compile Gaussians without a file, for tests and one-off pictures."""
    layout = arrange(gaussians)
    return Store(
        count=layout.count,
        sh_count=gaussians.sh.shape[1],
        layout=layout,
        path=None,
        key="",
        rasterize_mode=gaussians.rasterize_mode,
    )


def compile_store(gaussians: Gaussians, path: Path, *, key: str = "") -> None:
    """Compile Gaussians to a file, which appears whole or not at all.

    Args:
        gaussians: what to compile; those that can never be seen are left out.
        path: the file to write; its folder is made.
        key: identifies the content; `open_store` can insist on it.

    Raises:
        SceneError: when no Gaussian could ever be seen.
        StoreError: when the file cannot be written.
    """
    store = memory_store(gaussians)
    places: dict[str, tuple[int, int]] = {}
    offset = _HEADER_LIMIT
    arrays = store.layout.arrays()
    for name, array in arrays.items():
        places[name] = (offset, array.size)
        offset += -(-array.nbytes // _ALIGN) * _ALIGN
    header = {
        "magic": _MAGIC,
        "format": FORMAT,
        "key": key,
        "count": store.count,
        "sh_count": store.sh_count,
        "chunks": store.chunks,
        "arrays": places,
        "rasterize_mode": store.rasterize_mode,
    }
    with sealed_path(path) as temporary, temporary.open("wb") as file:
        file.write(json.dumps(header).encode().ljust(_HEADER_LIMIT - 1) + b"\n")
        for name, array in arrays.items():
            file.seek(places[name][0])
            file.write(array.data)


def open_store(path: Path, *, key: str | None = None) -> Store:
    """Map a compiled store read-only; its content is checked, which takes 10 ms a scene.

    Args:
        path: a file written by `compile_store`.
        key: the key that it must carry; None accepts any.

    Raises:
        SceneError: when the file is missing, damaged, of another layout or of another content.
    """
    try:
        mapped = read_sealed(path)
    except OSError as error:
        raise SceneError(f"{path}: {error.strerror or error}", fix=_REBUILD) from error
    except DamagedError as error:
        raise SceneError(f"{path}: {error}", fix=_REBUILD) from error
    header = _read_header(bytes(mapped[:_HEADER_LIMIT]), path)
    if key is not None and header["key"] != key:
        raise SceneError(f"{path}: holds {header['key']!r}, not {key!r}", fix=_REBUILD)
    try:
        arrays = {
            name: np.frombuffer(
                mapped,
                dtype=kind,
                offset=header["arrays"][name][0],
                count=header["arrays"][name][1],
            )
            for name, kind in _ARRAYS.items()
        }
        layout = Layout(count=header["count"], sh_count=header["sh_count"], **arrays)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise SceneError(
            f"{path}: its header does not describe it ({error})", fix=_REBUILD
        ) from error
    if not np.isfinite(layout.bounds).all():
        raise SceneError(f"{path}: its bounds are damaged", fix=_REBUILD)
    return Store(
        count=layout.count,
        sh_count=layout.sh_count,
        layout=layout,
        path=path,
        key=header["key"],
        rasterize_mode=header.get("rasterize_mode"),
    )


_REBUILD = "delete it; it is rebuilt on the next use"


def _read_header(raw: bytes, path: Path) -> dict[str, Any]:
    try:
        header: Any = json.loads(raw)
    except ValueError as error:
        raise SceneError(f"{path}: no compiled splat store", fix=_REBUILD) from error
    if not isinstance(header, dict) or header.get("magic") != _MAGIC:
        raise SceneError(f"{path}: no compiled splat store", fix=_REBUILD)
    if header.get("format") != FORMAT:
        raise SceneError(
            f"{path}: store format {header.get('format')}, this version reads {FORMAT}",
            fix=_REBUILD,
        )
    if not all(isinstance(header.get(k), int) for k in ("count", "sh_count")):
        raise SceneError(f"{path}: its header is incomplete", fix=_REBUILD)
    if header.get("rasterize_mode") not in (None, *RASTERIZE_MODES):
        raise SceneError(f"{path}: its header names no way to draw it", fix=_REBUILD)
    return header


def digest(gaussians: Gaussians) -> str:
    """Return the hex sha256 of the content of a set of Gaussians."""
    total = hashlib.sha256()
    for name in ("means", "log_scales", "quats", "opacity_logits", "sh"):
        array = getattr(gaussians, name)
        total.update(f"{name}{array.shape}".encode())
        total.update(array.data)
    if gaussians.rasterize_mode is not None:
        total.update(gaussians.rasterize_mode.encode())
    return total.hexdigest()
