"""What is taken of a repository: files at a revision, or of a scene's zip the parts that are read.

Names, sizes and numbers are untrusted: they are checked before anything is fetched or unpacked.
"""

from __future__ import annotations

import re
import shutil
import stat
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import quote

from nw_base.clean import clean
from nw_base.files.inside import OutsideError, checked
from nw_base.plural import in_words
from nw_scenes.hub import limits
from nw_scenes.hub.client import Client, Deadline, json_of
from nw_scenes.hub.reference import Reference, is_commit

_DIGITS = re.compile(r"[0-9a-fA-F]{7,40}")
_IDENTITY = re.compile(r"[0-9a-f]{40}|[0-9a-f]{64}")


@dataclass(frozen=True, kw_only=True)
class RemoteFile:
    """A file of a repository, as the hub says."""

    path: str
    """Relative, with slashes; it leaves no folder."""
    size: int
    """Bytes."""
    identity: str
    """Hex SHA-256 of a large file; of a small one Git's own digest: SHA-1 with a header."""


def commit_of(client: Client, reference: Reference) -> str:
    """Return the commit that a reference means now: 40 hexadecimal digits.

    Raises:
        SceneError, PolicyError: by the reference's kind: it names a commit, and the hub gives
            another one.
        ValueError: the hub gives none.
        SlowError: it takes too long.
    """
    wanted = reference.revision
    url = f"{_address(client, reference)}/revision/{quote(wanted, safe='')}"
    info, _ = json_of(client, url, Deadline(limits.SECONDS))
    commit = str(info["sha"])
    if not is_commit(commit):
        raise ValueError(f"{clean(commit, at_most=60)!r} is not a commit")
    # So many hexadecimal digits are meant as a commit, or its beginning, whoever has a branch so.
    if _DIGITS.fullmatch(wanted) and not commit.startswith(wanted.lower()):
        raise reference.error(
            f"{client.endpoint} gives commit {commit} for it",
            fix="write the commit that is wanted in full, and check HF_ENDPOINT and proxy",
        )
    return commit


def _address(client: Client, reference: Reference) -> str:
    return f"{client.endpoint}/api/{reference.repository_type}s/{reference.repository}"


def _entries(client: Client, reference: Reference, commit: str) -> Iterator[dict[str, Any]]:
    """Yield what the hub says of each file and folder."""
    archive = reference.archive
    below = "" if archive is None else f"/{quote(str(PurePosixPath(archive).parent))}"
    url: str | None = f"{_address(client, reference)}/tree/{commit}{below}"
    url = f"{url}?recursive={str(archive is None).lower()}&expand=false"
    deadline = Deadline(limits.SECONDS)
    for _ in range(limits.PAGES):
        page, url = json_of(client, url, deadline)
        yield from page
        if url is None:
            return
    raise ValueError(f"its listing has over {limits.PAGES} pages")


def files_of(client: Client, reference: Reference, commit: str) -> tuple[RemoteFile, ...]:
    """Return the files that are to be fetched, sorted by name.

    Names that begin with a dot are for Git and the hub, and are left out.

    Raises:
        SceneError, PolicyError: by the reference's kind: a name leaves the folder, there are too
            many files or too large ones, or the archive is missing.
        ValueError: the hub gives a digest that is none, or a listing without an end.
        SlowError: it takes too long.
    """
    archive = reference.archive
    files: list[RemoteFile] = []
    for entry in islice(_entries(client, reference, commit), 4 * limits.FILES):
        path = str(entry["path"])
        if entry["type"] != "file" or archive not in {None, path}:
            continue  # A folder, or another scene's archive.
        if any(part.startswith(".") for part in _checked(reference, path).parts):
            continue
        large = entry.get("lfs")
        identity = str(large["oid"] if large else entry["oid"])
        if not _IDENTITY.fullmatch(identity):  # It is to be the name of a file.
            raise ValueError(f"{clean(identity, at_most=80)!r} is not a digest")
        files.append(RemoteFile(path=path, size=int(entry["size"]), identity=identity))
    _check_amount(reference, files)
    return tuple(sorted(files, key=lambda file: file.path))


def _check_amount(reference: Reference, files: list[RemoteFile]) -> None:
    if not files:
        missing = reference.archive or "any file"
        raise reference.error(
            f"{reference.repository} does not hold {missing}", fix="check name and revision"
        )
    if len(files) > limits.FILES:
        raise reference.error(
            f"it has more than {limits.FILES} files", fix="give the scene its own repository"
        )
    total = sum(file.size for file in files)
    if min(file.size for file in files) < 0 or total > limits.BYTES:
        raise reference.error(
            f"it has {in_words(total)}, over the limit of {in_words(limits.BYTES)}",
            fix="leave out of the repository what the scene or policy does not need",
        )


def _checked(reference: Reference, path: str) -> PurePosixPath:
    try:
        return checked(path)
    except OutsideError as error:
        raise reference.error(
            f"the name {clean(path, at_most=100)!r} in it cannot be kept: {error}",
            fix="fetch nothing from its owner before that is explained",
        ) from None


_READ = (
    "*.xml",
    "geometry/*.obj",
    "3dgs/model.pt",
    "3dgs/model.ply",
    "3dgs/data_transforms.json",
)
"""What `neverwhere` reads of the folder that the zip's root is; the capture is gigabytes."""

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
                f"{clean(member.filename, at_most=100)!r} in it is not a regular file",
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
            fix="unpack it by hand, with the XML of the release's code, as "
            "docs/how-to/published-scenes.md says",
        )
    return list(wanted.values())


def _matches(name: str, pattern: str) -> bool:
    return name.count("/") == pattern.count("/") and fnmatchcase(name, pattern)
