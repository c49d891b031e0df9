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
a zero quaternion, are left out when the splat is compiled.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from nw_eval.errors import SceneError, UsageError, nearest
from nw_eval.files.cache import atomic_path, followed
from nw_eval.files.inside import regular
from nw_eval.files.ply import Ply
from nw_eval.splat.files.compiled import read_compiled
from nw_eval.splat.files.compressed_ply import read_compressed_ply
from nw_eval.splat.files.dot_splat import read_dot_splat, write_dot_splat
from nw_eval.splat.files.gsplat_pt import rank_files, read_gsplat_pt, write_gsplat_pt
from nw_eval.splat.files.nerfstudio import read_nerfstudio
from nw_eval.splat.files.sog import META, is_sog, read_sog
from nw_eval.splat.files.spz import read_spz, write_spz
from nw_eval.splat.files.threedgs_ply import RestOrder, read_threedgs_ply, write_threedgs_ply
from nw_eval.splat.gaussians import Gaussians
from nw_eval.splat.store import MARK

__all__ = ["RestOrder", "files_of_splat", "read_splat", "write_splat"]

_WRITERS = {
    ".ply": write_threedgs_ply,
    ".pt": write_gsplat_pt,
    ".spz": write_spz,
    ".splat": write_dot_splat,
}


def read_splat(path: Path, *, rest_order: RestOrder = "detect") -> Gaussians:
    """Read Gaussians from a file, or from the folder of a nerfstudio export.

    Args:
        path: the file or folder.
        rest_order: for 3DGS PLY files, how f_rest is arranged; see threedgs_ply.py.

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


_CONVERT = "convert it with `npx @playcanvas/splat-transform FILE out.ply`"
_NOT_READ = {
    ".ksplat": ("a splat of GaussianSplats3D", _CONVERT),
    ".lcc": ("a splat of XGRIDS", _CONVERT),
}


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
