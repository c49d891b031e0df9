"""The one way to resolve a path that an untrusted file names, within a folder of ours or theirs."""

from __future__ import annotations

import errno
import re
import stat
import zipfile
from pathlib import Path, PurePosixPath
from typing import Literal

from nw_base.clean import clean

_PATH, _NAME = 2048, 255  # bytes of a path, and of one name in it, that file systems take


class OutsideError(ValueError):
    """A name leads out of its folder; the message says how, for an error of the caller's kind."""


def inside(folder: Path, name: str) -> Path:
    """Return the path of a name below a folder, links followed.

    Args:
        folder: which nothing may leave; it need not exist.
        name: relative, with slashes; what it names need not exist.

    Raises:
        OutsideError: as `checked`; or a link on the way leads out of the folder.
    """
    relative = checked(name)
    root = folder.resolve()
    try:
        path = (root / relative).resolve()
    except (OSError, RuntimeError) as error:  # A circle of links, a name that is too long.
        raise OutsideError(f"it cannot be resolved: {error}") from None
    if not path.is_relative_to(root):
        raise OutsideError(f"a link on its way leads to {path}")
    return path


def checked(name: str) -> PurePosixPath:
    """Return a name as a relative path, where there is nothing to view yet.

    Raises:
        OutsideError: the name is empty or too long, is absolute, has `..`, a drive, a scheme, a
            backslash or a zero byte.
    """
    if not name or "\0" in name:
        raise OutsideError("it is empty" if not name else "it has a zero byte")
    if "\\" in name or re.match(r"[A-Za-z][\w+.-]*:", name):
        raise OutsideError("it has a backslash, a drive or a scheme")
    relative = PurePosixPath(name)
    if relative.is_absolute():
        raise OutsideError("it is an absolute path")
    if ".." in relative.parts:
        raise OutsideError("it has `..`")
    if _bytes(name) > _PATH or max(map(_bytes, relative.parts), default=0) > _NAME:
        raise OutsideError("it is longer than a file system allows")
    return relative


def _bytes(part: str) -> int:
    return len(part.encode(errors="replace"))


def regular(path: Path) -> Path:
    """Return a path, unless what is there may never begin or end to be read.

    Every reader of a path that a user or a file names asks this first.

    Raises:
        OSError: a pipe, a device or a socket is there; `strerror` says which.
    """
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):
        return path  # Whoever opens it says what is wrong.
    for kind, is_one in (("pipe", stat.S_ISFIFO), ("socket", stat.S_ISSOCK)):
        if is_one(mode):
            raise OSError(errno.EINVAL, f"it is a {kind}, not a file", str(path))
    if stat.S_ISCHR(mode) or stat.S_ISBLK(mode):
        raise OSError(errno.EINVAL, "it is a device, not a file", str(path))
    return path


def what_is(path: Path) -> Literal["file", "folder", "nothing"]:
    """Return what lies at a path; nothing does at one that no file system can have, or show."""
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):  # Too long a name, a zero byte, a circle of links.
        return "nothing"
    return "file" if stat.S_ISREG(mode) else "folder" if stat.S_ISDIR(mode) else "nothing"


_UNPACK = "unpack it, and give what is in it"
_MESH = "convert it to .glb, .obj, .ply or .stl, with Blender or CloudCompare"
_STAGE = "give it as .usdz, .usdc or .usda to `nw-eval scenes import`"
_CLOUD = "give its points as .las, .e57 or .ply to `nw-eval scenes import`, or export a mesh"
_MARKS: tuple[tuple[bytes, str, str], ...] = (
    (b"version https://git-lfs", "a Git LFS pointer, not the file itself", "run `git lfs pull`"),
    (b"\x1f\x8b", "compressed with gzip", "unpack it with `gunzip`"),
    (b"\x28\xb5\x2f\xfd", "compressed with zstd", "unpack it with `unzstd`"),
    (b"BZh", "compressed with bzip2", "unpack it with `bunzip2`"),
    (b"\xfd7zXZ", "compressed with xz", "unpack it with `unxz`"),
    (b"7z\xbc\xaf", "a 7z archive", _UNPACK),
    (b"Rar!", "a RAR archive", _UNPACK),
    (b"<!doctype html", "a web page", "download the file itself"),
    (b"<html", "a web page", "download the file itself"),
    (b"kaydara fbx", "an FBX scene", _MESH),
    (b"pxr-usdc", "a USD stage", _STAGE),
    (b"#usda", "a USD stage", _STAGE),
    (b"<?xml", "XML, such as COLLADA", _MESH),
    (b"lasf", "a LAS point cloud", _CLOUD),
    (b"astm-e57", "an E57 point cloud", _CLOUD),
    (b"# .pcd", "a PCD point cloud", _CLOUD),
)


def foreign(path: Path) -> tuple[str, str] | None:
    """Return what a file is that no reader of scans reads, and what to do; None if it may be one.

    Told by how it begins, whatever it is called. A zip archive is named with what is in it.
    """
    try:
        with regular(path).open("rb") as file:
            mark = file.read(32)
    except (OSError, ValueError):
        return None  # Whoever opens it says what is wrong.
    if not mark:
        return "empty", "copy it again"
    if mark[:4] == b"PK\x03\x04":
        try:
            with zipfile.ZipFile(path) as archive:
                names = [one for one in archive.namelist() if not one.endswith("/")]
        except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError):
            return "a damaged zip archive", "copy it again"
        listed = ", ".join(clean(one, at_most=60) for one in names[:3])
        if any(one.lower().endswith((".usdc", ".usda", ".usd")) for one in names):
            return f"a USDZ package with {listed}", _STAGE
        more = f" and {len(names) - 3} more" if len(names) > 3 else ""
        return f"a zip archive with {listed or 'nothing'}{more}", _UNPACK
    for begin, what, fix in _MARKS:
        if mark.lower().startswith(begin.lower()):
            return what, fix
    return None


def bounded_bytes(path: Path, most: int) -> bytes:
    """Return the content of a plain file of at most `most` bytes.

    Raises:
        FileNotFoundError: there is none.
        OSError: it cannot be read.
        ValueError: it is too large, or a device or pipe, which may never end.
    """
    facts = path.stat()
    if not stat.S_ISREG(facts.st_mode):
        raise ValueError("it is not a file")
    if facts.st_size > most:
        whole = max(round(facts.st_size / 2**20), most // 2**20 + 1)
        raise ValueError(f"it has {whole} MiB, over {most // 2**20}")
    with path.open("rb") as stream:
        return stream.read(most)
