"""Splat files: which format a file is in, and the way to its reader or writer.

What formats there are: `FORMATS`, those of installed packages (`format.py`), and the folder of a
nerfstudio splatfacto export, with splat.ply and dataparser_transforms.json.

Built-in formats are told by content; only .splat, which has no mark, is told by its name.
Everything comes back in the axes of the 3DGS PLY file, as it is: Gaussians with values that are not
finite, or with a zero quaternion, are left out when the splat is compiled. Compiled splats lie in
the user's cache; they are made on first use.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import cast

from nw_base.errors import NwEvalError, PluginError, SceneError, UsageError, nearest
from nw_base.files.cache import atomic_path, cache_dir, followed
from nw_base.files.inside import foreign, regular
from nw_base.plugins import (
    SPLAT_FORMATS,
    identity_of,
    installed,
    load,
    subject,
    warn_if_built_in,
)
from nw_base.plural import plural
from nw_base.words import RasterizeMode
from nw_splat.files.format import SplatFormat
from nw_splat.files.gsplat_pt import EXPORT, GSPLAT_PT, rank_files
from nw_splat.files.ply import DOT_SPLAT, PLY, TRANSFORMS, read_nerfstudio
from nw_splat.files.sog import META, SOG, read_sog
from nw_splat.files.spz import SPZ
from nw_splat.gaussians import Gaussians, drawable
from nw_splat.store import (
    FORMAT,
    MARK,
    SUFFIX,
    compile_store,
    digest,
    open_store,
    read_compiled,
)

_READING = 2
"""Changes with what the readers make of a file; part of the key of every file's store."""

NWSPLAT = SplatFormat(
    name=SUFFIX.removeprefix("."),
    description="nw-eval's own compiled form, from its cache; only read",
    read=read_compiled,
    sniff=lambda _, mark: mark[: len(MARK)] == MARK,
)

FORMATS = MappingProxyType(
    {each.name: each for each in (PLY, SPZ, SOG, DOT_SPLAT, GSPLAT_PT, NWSPLAT)}
)
"""The formats that are built in, by name, in the order in which they are asked for a file."""

_CONVERT = "convert it with `npx @playcanvas/splat-transform FILE out.ply`"
_NOT_READ = {
    ".ksplat": ("a splat of GaussianSplats3D", _CONVERT),
    ".lcc": ("a splat of XGRIDS", _CONVERT),
}


def read_splat(path: Path) -> Gaussians:
    """Read Gaussians from a file, or from the folder of a nerfstudio export.

    Args:
        path: the file or folder.

    Raises:
        SceneError: naming file, place and what is wrong. Memory stays within a small multiple of
            the file's size whatever it claims to hold.
        PluginError: a package that brings along its format is broken.
    """
    path = Path(path)
    try:
        if path.is_dir():
            return read_sog(path / META) if (path / META).is_file() else _of_folder(path)
        with regular(path).open("rb") as file:
            mark = file.read(max(_MARK, len(MARK)))
        if (name := package_format(path)) is not None:
            return _read_by_package(name, path, mark)
        return _format_of(path, mark).read(path)
    except OSError as error:
        raise SceneError(f"{path}: {error.strerror or error}", fix="give a splat file") from error


def _of_folder(folder: Path) -> Gaussians:
    """Read a nerfstudio export.

    Raises:
        SceneError: it is none; of a training's folder, with the file to give.
    """
    plys = folder.glob("point_cloud/iteration_*/point_cloud.ply"), folder.glob("ply/*.ply")
    splats = [one for each in (*plys, folder.glob("ckpts/*.pt")) for one in each]
    if splats and not (folder / TRANSFORMS).is_file():
        newest = max(splats, key=lambda one: [int(n) for n in re.findall(r"\d+", str(one))])
        raise SceneError(
            f"{folder}: the folder of a 3DGS training, with {plural(len(splats), 'splat')} in it",
            fix=f"give the splat of one iteration, such as {newest}",
        )
    if (folder / "nerfstudio_models").is_dir():
        raise SceneError(f"{folder}: the folder of a nerfstudio training", fix=EXPORT)
    return read_nerfstudio(folder)


_GZIP = b"\x1f\x8b"
_MARK = 16
"""Bytes of a file by which its format is told."""


def _format_of(path: Path, mark: bytes) -> SplatFormat:
    """Return the built-in format of a file that begins with `mark`."""
    suffix = path.suffix.lower()
    for each in FORMATS.values():
        if each.sniff is not None and each.sniff(path, mark):
            return each
        if each.suffix == suffix == ".spz" and mark[:2] == _GZIP:
            return each  # What is compressed is damaged: its reader says how.
    other = foreign(path)
    known = other or _NOT_READ.get(suffix)
    for each in FORMATS.values():
        if known is None and each.sniff is None and each.suffix == suffix:
            return each
    if known is None and path.name == "cfg_args":
        known = "the options of a 3DGS training", "give point_cloud/iteration_N/point_cloud.ply"
    if known is None and mark[:1] == b"\x80":
        known = "a pickle", "load it with torch and save it again with torch.save"
    if known is not None:
        what = f"{path}: it is {known[0]}" + (", which is not read" if other is None else "")
        raise SceneError(what, fix=known[1])
    raise SceneError(
        f"{path}: starts with {mark[:4]!r}, which is not a splat format",
        fix="give .ply, .spz, .sog, .splat, a gsplat .pt, or a nerfstudio export folder",
    )


def package_format(path: Path) -> str | None:
    """Return the name of the format of a package that a file's suffix says; None if none does.

    The package is not imported.
    """
    name = path.suffix.lower().removeprefix(".")
    if name in FORMATS:
        warn_if_built_in(SPLAT_FORMATS, name)
        return None
    return name if name in installed(SPLAT_FORMATS) else None


def _read_by_package(name: str, path: Path, mark: bytes) -> Gaussians:
    """Read a file of a package's format.

    Raises:
        SceneError: the file is none of that format, or its reader failed.
        PluginError: the package is broken.
    """
    form = load(SPLAT_FORMATS, name, SplatFormat)
    who = subject(installed(SPLAT_FORMATS)[name][0])
    try:
        is_one = form.sniff is None or form.sniff(path, mark[:_MARK])
        gaussians = cast("object", form.read(path)) if is_one else None
    except (NwEvalError, OSError):
        raise
    except Exception as error:
        raise SceneError(
            f"{path}: {who} cannot read it: {type(error).__name__}: {error}",
            fix="the file is damaged, or that package is",
        ) from error
    if not is_one:
        raise SceneError(
            f"{path}: starts with {mark[:4]!r}, which {who} does not read",
            fix=f"give a file of the format {name}: {form.description}",
        )
    if not isinstance(gaussians, Gaussians):
        raise PluginError(f"{who} read a {type(gaussians).__name__}, no Gaussians, from {path}")
    return gaussians


def files_of_splat(path: Path) -> tuple[Path, ...]:
    """Return the files that `read_splat` reads at a path: one, or all ranks of a checkpoint.

    Raises:
        SceneError: a rank is missing.
    """
    return rank_files(path)


def write_splat(path: Path, gaussians: Gaussians) -> int:
    """Write Gaussians in the format of the name: .ply, .pt (exact), .spz or .splat (lossy).

    A package's format writes its own files. What cannot be drawn is left out, see `left_out`.

    Returns:
        The size of the file in bytes.

    Raises:
        UsageError: for another suffix.
        SceneError: when the format cannot hold them.
    """
    path = Path(path)
    write = _writer(path)
    with atomic_path(followed(path)) as temporary:
        write(temporary, gaussians if _is_exact(path) else gaussians.take(drawable(gaussians)))
        return temporary.stat().st_size


def left_out(path: Path, gaussians: Gaussians) -> int:
    """Return how many Gaussians `write_splat` leaves out: those that cannot be drawn.

    Exact formats keep them as they are. Others would make something of them: bytes have no nan.
    """
    return 0 if _is_exact(path) else int((~drawable(gaussians)).sum())


def _is_exact(path: Path) -> bool:
    return path.suffix.lower() in {PLY.suffix, GSPLAT_PT.suffix}


def _writer(path: Path) -> Callable[[Path, Gaussians], None]:
    """Return the writer for a file name.

    Raises:
        UsageError: nothing does.
        PluginError: the package that has its format is broken.
    """
    if (name := package_format(path)) is not None:
        form = load(SPLAT_FORMATS, name, SplatFormat)
    else:
        form = FORMATS.get(path.suffix.lower().removeprefix("."))
    if form is not None and form.write is not None:
        return form.write
    written = [each.suffix for each in FORMATS.values() if each.write is not None]
    raise UsageError(
        f"{path}: cannot write {path.suffix or 'a file without suffix'!r}",
        fix=nearest(path.suffix, written),
    )


def digest_of_files(path: Path) -> str:
    """Return the hex sha256 of a splat file; of its ranks', if they are several.

    Where a package reads the file, its version and its code count, too.

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
    if (name := package_format(path)) is not None:
        parts.append(identity_of(SPLAT_FORMATS, name))
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
