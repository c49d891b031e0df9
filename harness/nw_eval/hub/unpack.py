"""The parts of a published scene's zip that are read, into a folder; nothing else of it."""

from __future__ import annotations

import shutil
import stat
import zipfile
import zlib
from fnmatch import fnmatchcase
from pathlib import Path

from nw_eval.amounts import in_words
from nw_eval.clean import clean
from nw_eval.files.inside import OutsideError, checked
from nw_eval.hub import limits
from nw_eval.hub.reference import Reference

_READ = (
    "*.xml",
    "geometry/*.obj",
    "3dgs/model.pt",
    "3dgs/model.ply",
    "3dgs/data_transforms.json",
)
"""What `scenes.neverwhere` reads of the folder that the zip's root is; the capture is gigabytes."""

_FAULTS = (zipfile.BadZipFile, zlib.error, EOFError, ValueError, RuntimeError)


def unpack(reference: Reference, archive: Path, folder: Path) -> tuple[str, ...]:
    """Unpack what is read of a scene, and return the names.

    Args:
        reference: what the archive is of.
        archive: the zip.
        folder: an empty folder.

    Raises:
        SceneError: the zip is damaged, a name leaves the folder, it is too large, or it has no XML.
        OSError: something cannot be written.
    """
    try:
        with zipfile.ZipFile(archive) as opened:
            wanted = _wanted(reference, opened)
            for member in wanted:
                path = folder / member.filename
                path.parent.mkdir(parents=True, exist_ok=True)
                # It stops at the announced size with an error if there is more.
                with opened.open(member) as packed, path.open("wb") as out:
                    shutil.copyfileobj(packed, out, 2**20)
    except _FAULTS as error:
        raise reference.error(
            f"{reference.archive} is damaged: {clean(error, at_most=200)}", fix="fetch it again"
        ) from None
    return tuple(member.filename for member in wanted)


def _wanted(reference: Reference, opened: zipfile.ZipFile) -> list[zipfile.ZipInfo]:
    wanted: dict[str, zipfile.ZipInfo] = {}
    for member in opened.infolist():
        if member.is_dir() or not any(_matches(member.filename, each) for each in _READ):
            continue
        kind = stat.S_IFMT(member.external_attr >> 16)
        if kind not in {0, stat.S_IFREG}:
            raise reference.error(
                f"{clean(member.filename, at_most=100)!r} in it is no plain file",
                fix="fetch nothing from its owner before that is explained",
            )
        try:
            checked(member.filename)
        except OutsideError as error:
            raise reference.error(
                f"the name {clean(member.filename, at_most=100)!r} in it: {error}",
                fix="fetch nothing from its owner before that is explained",
            ) from None
        wanted[member.filename] = member
    total = sum(member.file_size for member in wanted.values())
    if len(wanted) > limits.FILES or total > limits.BYTES:
        raise reference.error(
            f"{len(wanted)} files of {in_words(total)} would be unpacked",
            fix=f"{limits.FILES} files and {in_words(limits.BYTES)} are the limit",
        )
    if not any(name.endswith(".xml") for name in wanted):
        raise reference.error(
            f"{reference.archive} holds no XML at its root, which says where everything lies",
            fix="unpack it by hand, with the XML of the release's code, as docs/scenes.md says",
        )
    return list(wanted.values())


def _matches(name: str, pattern: str) -> bool:
    return name.count("/") == pattern.count("/") and fnmatchcase(name, pattern)
