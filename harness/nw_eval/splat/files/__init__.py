"""Splat files: which format a file is in, and the way to its reader or writer.

    .ply      3DGS (gsplat, splatfacto, Polycam, SuperSplat), and SuperSplat's compressed form
    .spz      Niantic's, versions 1 to 4
    .sog      PlayCanvas's, versions 1 and 2; also its meta.json; only read
    .splat    antimatter15's 32 bytes per Gaussian, no harmonics
    .pt       a gsplat training checkpoint, with the other ranks of its step beside it
    .nwsplat  nw-eval's own compiled form, from its cache; only read
    folder    a nerfstudio splatfacto export: splat.ply and dataparser_transforms.json

Formats are told by content; only .splat, which has no mark, is told by its name. Everything comes
back in the axes of the 3DGS PLY file, as it is: Gaussians with values that are not finite, or with
a zero quaternion, are left out when the splat is compiled. Compiled splats lie in the user's cache;
they are made on first use.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from nw_eval.errors import SceneError, UsageError, nearest
from nw_eval.files.cache import atomic_path, cache_dir, followed
from nw_eval.files.inside import regular
from nw_eval.files.ply import Ply
from nw_eval.splat.files.dot_splat import read_dot_splat, write_dot_splat
from nw_eval.splat.files.gsplat_pt import rank_files, read_gsplat_pt, write_gsplat_pt
from nw_eval.splat.files.ply import (
    RestOrder,
    read_compressed_ply,
    read_nerfstudio,
    read_threedgs_ply,
    write_threedgs_ply,
)
from nw_eval.splat.files.sog import META, is_sog, read_sog
from nw_eval.splat.files.spz import read_spz, write_spz
from nw_eval.splat.gaussians import Gaussians
from nw_eval.splat.store import (
    FORMAT,
    MARK,
    SUFFIX,
    compile_store,
    digest,
    open_store,
    read_compiled,
)
from nw_eval.words import RasterizeMode

_READING = 1
"""Changes with what the readers make of a file; part of the key of every file's store."""

_WRITERS = {
    ".ply": write_threedgs_ply,
    ".pt": write_gsplat_pt,
    ".spz": write_spz,
    ".splat": write_dot_splat,
}

_CONVERT = "convert it with `npx @playcanvas/splat-transform FILE out.ply`"
_NOT_READ = {
    ".ksplat": ("a splat of GaussianSplats3D", _CONVERT),
    ".lcc": ("a splat of XGRIDS", _CONVERT),
}


def read_splat(path: Path, *, rest_order: RestOrder = "detect") -> Gaussians:
    """Read Gaussians from a file, or from the folder of a nerfstudio export.

    Args:
        path: the file or folder.
        rest_order: for 3DGS PLY files, how f_rest is arranged; see ply.py.

    Raises:
        SceneError: naming file, place and what is wrong. Memory stays within a small multiple of
            the file's size whatever it claims to hold.
    """
    path = Path(path)
    try:
        if path.is_dir():
            if (path / META).is_file():
                return read_sog(path / META)
            return read_nerfstudio(path, rest_order=rest_order)
        with regular(path).open("rb") as file:
            mark = file.read(len(MARK))
        return _reader(path, mark, rest_order)(path)
    except OSError as error:
        raise SceneError(f"{path}: {error.strerror or error}", fix="give a splat file") from error


def _reader(path: Path, mark: bytes, rest_order: RestOrder) -> Callable[[Path], Gaussians]:
    """Return what reads a file that begins with `mark`."""
    suffix = path.suffix.lower()
    if mark == MARK:
        return read_compiled
    if mark[:3] == b"ply":
        return partial(_read_ply, rest_order=rest_order)
    if mark[:2] == b"\x1f\x8b" or mark[:4] == b"NGSP":
        return read_spz
    if mark[:4] == b"PK\x03\x04":
        return read_sog if is_sog(path) else read_gsplat_pt
    if path.name == META:
        return read_sog
    if suffix == ".splat":
        return read_dot_splat
    known = _NOT_READ.get(suffix)
    if known is None and mark[:1] == b"\x80":
        known = "a pickle", "load it with torch and save it again with torch.save"
    if known is not None:
        raise SceneError(f"{path}: {known[0]}, which is not read", fix=known[1])
    raise SceneError(
        f"{path}: starts with {mark[:4]!r}, which is not a splat format",
        fix="give .ply, .spz, .sog, .splat, a gsplat .pt, or a nerfstudio export folder",
    )


def _read_ply(path: Path, *, rest_order: RestOrder) -> Gaussians:
    ply = Ply.open(path)
    if "chunk" in ply.elements:
        return read_compressed_ply(ply)
    return read_threedgs_ply(ply, rest_order=rest_order)


def files_of_splat(path: Path) -> tuple[Path, ...]:
    """Return the files that `read_splat` reads at a path: one, or all ranks of a checkpoint.

    Raises:
        SceneError: a rank is missing.
    """
    return rank_files(path)


def write_splat(path: Path, gaussians: Gaussians) -> int:
    """Write Gaussians in the format of the name: .ply, .pt (exact), .spz or .splat (lossy).

    Returns:
        The size of the file in bytes.

    Raises:
        UsageError: for another suffix.
        SceneError: when the format cannot hold them.
    """
    path = Path(path)
    writer = _WRITERS.get(path.suffix.lower())
    if writer is None:
        raise UsageError(
            f"{path}: cannot write {path.suffix or 'a file without suffix'!r}",
            fix=nearest(path.suffix, _WRITERS),
        )
    with atomic_path(followed(path)) as temporary:
        writer(temporary, gaussians)
        return temporary.stat().st_size


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
