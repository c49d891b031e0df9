"""Compiled splats in the user's cache, made on first use."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

from nw_eval.errors import SceneError
from nw_eval.files.cache import cache_dir
from nw_eval.files.inside import regular
from nw_eval.splat.files import files_of_splat, read_splat
from nw_eval.splat.gaussians import Gaussians
from nw_eval.splat.store import FORMAT, SUFFIX, compile_store, digest, open_store
from nw_eval.words import RasterizeMode

_READING = 1
"""Changes with what the readers make of a file; part of the key of every file's store."""


def digest_of_files(path: Path) -> str:
    """Return the hex sha256 of a splat file; of its ranks', if they are several.

    Raises:
        SceneError: one cannot be read.
    """
    parts: list[str] = []
    for one in files_of_splat(path):
        try:
            with regular(one).open("rb") as file:
                parts.append(hashlib.file_digest(file, "sha256").hexdigest())
        except OSError as error:
            raise SceneError(
                f"{one}: the splat cannot be read: {error.strerror or error}",
                fix="check the key `splat` of scene.yaml",
            ) from None
    return parts[0] if len(parts) == 1 else hashlib.sha256("".join(parts).encode()).hexdigest()


def compiled_store(
    source: Path | Gaussians,
    key: str | None = None,
    *,
    rasterize_mode: RasterizeMode | None = None,
) -> Path:
    """Return the path of a compiled store in the user's cache, compiling on first use.

    Args:
        source: a splat file, or Gaussians.
        key: what identifies the content; by default a hash of it. With a key of one's own, a file
            is read and hashed only when the cache has nothing for it.
        rasterize_mode: how to draw it in place of the source's own mark; None keeps that.

    Returns:
        A path for `open_store`. A damaged or foreign file there has been replaced.

    Raises:
        SceneError: when the source cannot be read or has nothing to see.
        StoreError: when the cache cannot be written.
    """
    if key is None:
        key = digest(source) if isinstance(source, Gaussians) else digest_of_files(source)
    full_key = f"{FORMAT}:{key}"
    if not isinstance(source, Gaussians):
        full_key = f"{FORMAT}.{_READING}:{key}"
    if rasterize_mode is not None:
        full_key += f":{rasterize_mode}"
    name = hashlib.sha256(full_key.encode()).hexdigest()[:32]
    path = cache_dir("splats") / f"{name}{SUFFIX}"
    if path.exists():
        try:
            open_store(path, key=full_key)
        except SceneError:
            pass
        else:
            return path
    gaussians = source if isinstance(source, Gaussians) else read_splat(source)
    if rasterize_mode is not None:
        gaussians = replace(gaussians, rasterize_mode=rasterize_mode)
    compile_store(gaussians, path, key=full_key)
    return path
