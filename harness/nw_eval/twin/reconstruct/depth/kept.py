"""Arrays on disk with what they are of, so that a second call takes up what the first left."""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import SceneError, UsageError
from nw_eval.files.cache import atomic_path
from nw_eval.files.inside import OutsideError, inside
from nw_eval.twin.reconstruct.depth.sweep import Sweep
from nw_eval.twin.reconstruct.depth.view import WorkingView
from nw_eval.twin.reconstruct.options import DepthOptions

_FORMAT = 1
"""Changes with what a sweep does."""

_NAMES = ("depth", "likeness", "unique")
_DAMAGE = (OSError, ValueError, LookupError, TypeError, EOFError, BadZipFile, zlib.error)
"""What NumPy raises at damaged files."""


def array_file(folder: Path, shot: str) -> Path:
    """Return where the arrays of a shot are: `<folder>/<shot>.npz`, e.g. IMG_0012.jpg.npz.

    Raises:
        UsageError: the shot's name leads out of the folder.
    """
    try:
        return inside(folder, f"{shot}.npz")
    except OutsideError as error:
        raise UsageError(
            f"a shot is called {shot!r}: {error}", fix="give it another name and calibrate again"
        ) from None


def write_arrays(path: Path, **arrays: NDArray[Any]) -> None:
    """Write arrays; a reader sees the old file or the new one whole.

    Raises:
        StoreError: the file cannot be written.
    """
    with atomic_path(path) as temporary:
        np.savez_compressed(temporary, allow_pickle=False, **arrays)


def read_depth(folder: Path, shot: str) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return a shot's depth along the optical axis and its confidence, (H, W), 0 where not known.

    Raises:
        SceneError: the folder has none of that shot, or it is damaged.
    """
    path = array_file(folder, shot)
    try:
        depth, confidence = (a.astype(np.float32) for a in _arrays(path, ("depth", "confidence")))
        if depth.ndim != 2 or depth.shape != confidence.shape:
            raise ValueError(f"arrays of shapes {depth.shape} and {confidence.shape}")
    except _DAMAGE as error:
        raise SceneError(f"{path} holds no depth: {error}", fix="reconstruct again") from None
    known = np.isfinite(depth) & (depth > 0.0) & np.isfinite(confidence)
    sure = np.clip(confidence, 0.0, 1.0)
    return (np.where(known, depth, np.float32(0.0)), np.where(known, sure, np.float32(0.0)))


def write_sweep(path: Path, found: Sweep, key: str) -> None:
    """Keep a sweep under the key of what it is of.

    Raises:
        StoreError: the file cannot be written.
    """
    likeness, unique = (np.round(a * 255).astype(np.int16) for a in (found.likeness, found.unique))
    write_arrays(path, depth=found.depth, likeness=likeness, unique=unique, key=np.array(key))


def read_sweep(path: Path, key: str) -> Sweep | None:
    """Return what `write_sweep` kept; None if there is nothing, or of something else."""
    try:
        found, depth, likeness, unique = _arrays(path, ("key", *_NAMES))
    except _DAMAGE:
        return None
    if str(found) != key:
        return None
    scale = np.float32(1.0 / 255.0)
    return Sweep(depth=depth, likeness=likeness * scale, unique=unique * scale)


def _arrays(path: Path, names: Sequence[str]) -> list[NDArray[Any]]:
    """Return arrays of a file; whatever it raises is in `_DAMAGE`."""
    with np.load(path, allow_pickle=False) as arrays:
        return [np.asarray(arrays[name]) for name in names]


def key_of(
    view: WorkingView, others: list[WorkingView], reach: tuple[float, float], options: DepthOptions
) -> str:
    """Return the hex SHA-256 of all that a sweep depends on."""
    # What is done with a sweep afterwards makes no other one.
    chosen = {k: v for k, v in asdict(options).items() if k not in {"least_agreeing", "tolerance"}}
    content = hashlib.sha256(json.dumps([_FORMAT, chosen, reach], sort_keys=True).encode())
    for each in (view, *others):
        content.update(repr(each.size).encode())
        for array in (each.K, each.T_camera_world, each.rgb):
            content.update(np.ascontiguousarray(array).tobytes())
    return content.hexdigest()
