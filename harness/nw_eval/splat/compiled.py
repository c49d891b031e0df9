"""Compiled splats in the user's cache, made on first use."""

from __future__ import annotations

import hashlib
from pathlib import Path

from nw_eval.errors import SceneError
from nw_eval.files.cache import cache_dir
from nw_eval.files.inside import regular
from nw_eval.splat.files import read_splat
from nw_eval.splat.gaussians import Gaussians
from nw_eval.splat.store import FORMAT, SUFFIX, compile_store, digest, open_store


def compiled_store(source: Path | Gaussians, key: str | None = None) -> Path:
    """Return the path of a compiled store in the user's cache, compiling on first use.

    Args:
        source: a splat file, or Gaussians.
        key: what identifies the content; by default a hash of it. With a key of one's own, a file
            is read and hashed only when the cache has nothing for it.

    Returns:
        A path for `open_store`. A damaged or foreign file there has been replaced.

    Raises:
        SceneError: when the source cannot be read or has nothing to see.
        StoreError: when the cache cannot be written.
    """
    if key is None:
        if isinstance(source, Gaussians):
            key = digest(source)
        else:
            try:
                with regular(source).open("rb") as file:
                    key = hashlib.file_digest(file, "sha256").hexdigest()
            except OSError as error:
                raise SceneError(f"{source}: {error.strerror or error}") from error
    full_key = f"{FORMAT}:{key}"
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
    compile_store(gaussians, path, key=full_key)
    return path
