"""Archives: members are checked all together before any of them is unpacked."""

from __future__ import annotations

import io
import stat
import struct
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import PurePosixPath

from nw_eval.clean import clean
from nw_eval.errors import PolicyError
from nw_eval.policies.safety.limits import FileLimits

ZIP_FAULTS = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    EOFError,
    OSError,
    ValueError,
    RuntimeError,  # NotImplementedError too: a compression or encryption that it lacks.
)
"""What Python's zip reader raises about damaged archives."""


@dataclass(frozen=True, kw_only=True)
class Archive:
    """A zip file in memory whose members passed all checks. Nothing is written to disk."""

    where: str
    zip: zipfile.ZipFile
    root: str
    """The folder that all members of a torch file lie in, with its slash; "" if there is none."""

    def names(self) -> tuple[str, ...]:
        """Return member names below the root."""
        return tuple(
            name[len(self.root) :]
            for name in self.zip.namelist()
            if name.startswith(self.root) and not name.endswith("/")
        )

    def size(self, name: str) -> int | None:
        """Return the unpacked size of a member below the root, bytes; None if it is absent."""
        try:
            return self.zip.getinfo(self.root + name).file_size
        except KeyError:
            return None

    def read(self, name: str, *, at_most: int | None = None) -> bytes:
        """Return a member below the root.

        Raises:
            PolicyError: it is absent, over `at_most` bytes, or damaged.
        """
        size = self.size(name)
        if size is None:
            raise PolicyError(
                f"{self.where}: the archive has no {name!r}",
                fix="the file is incomplete: export it again",
            )
        if at_most is not None and size > at_most:
            raise PolicyError(
                f"{self.where}: {name!r} has {_mib(size)}, over the limit of {_mib(at_most)}",
                fix="export the actor alone",
            )
        try:
            return self.zip.read(self.root + name)
        except ZIP_FAULTS as error:
            raise PolicyError(
                f"{self.where}: {name!r} is damaged: {clean(error, at_most=200)}",
                fix="copy or download the file again",
            ) from None


def open_archive(data: bytes, where: str, limits: FileLimits | None = None) -> Archive:
    """Check the members of a zip file and open it.

    Args:
        data: the whole file.
        where: its path, for errors.
        limits: bounds on members and sizes.

    Raises:
        PolicyError: no archive, a damaged one, too many or too large members, a compression that
            only a bomb has, a name that points outside, a link, an encrypted or repeated member.
    """
    limits = limits or FileLimits()
    if len(data) > limits.file_bytes:
        raise PolicyError(
            f"{where}: the file has {_mib(len(data))}, over the limit of {_mib(limits.file_bytes)}",
            fix="export the actor alone, without optimiser state",
        )
    try:
        archive = zipfile.ZipFile(io.BytesIO(data))
        members = archive.infolist()
    except ZIP_FAULTS as error:
        raise PolicyError(
            f"{where}: not an archive, or a truncated one: {clean(error, at_most=200)}",
            fix="copy or download the file again",
        ) from None
    if len(members) > limits.members:
        raise PolicyError(
            f"{where}: the archive has {len(members)} members, over the limit of {limits.members}",
            fix="export the actor alone",
        )
    seen: set[str] = set()
    folded: set[str] = set()
    for member in members:
        fault = _fault(member, limits)
        if member.filename in seen:
            fault = "appears twice, so that readers may disagree about it"
        elif member.filename.casefold() in folded:
            # Torch's reader ignores case, Python's does not.
            fault = "appears twice but for its case, so that readers may disagree about it"
        if fault is not None:
            raise PolicyError(
                f"{where}: the archive's member {clean(member.filename, at_most=200)!r} {fault}",
                fix="do not use this file; export the policy again",
            )
        seen.add(member.filename)
        folded.add(member.filename.casefold())
    unpacked = sum(member.file_size for member in members)
    if unpacked > limits.unpacked_bytes:
        raise PolicyError(
            f"{where}: the archive unpacks to {_mib(unpacked)}, over the limit of "
            f"{_mib(limits.unpacked_bytes)}",
            fix="export the actor alone, without optimiser state",
        )
    return Archive(where=where, zip=archive, root=_root(seen))


def _fault(member: zipfile.ZipInfo, limits: FileLimits) -> str | None:
    path = PurePosixPath(member.filename)
    raw = member.orig_filename
    if path.is_absolute() or ".." in path.parts or "\\" in raw or ":" in raw or "\0" in raw:
        return "points outside the archive"
    if stat.S_ISLNK(member.external_attr >> 16):
        return "is a link"
    if member.flag_bits & 0x1:
        return "is encrypted"
    if member.file_size > limits.compression * max(member.compress_size, 1) + 2**16:
        ratio = member.file_size // max(member.compress_size, 1)
        return f"is compressed {ratio} times, like a zip bomb"
    return None


def _root(names: set[str]) -> str:
    tops = {name.split("/", 1)[0] for name in names}
    inside = all("/" in name for name in names)
    return f"{tops.pop()}/" if inside and len(tops) == 1 else ""


def _mib(size: int) -> str:
    return f"{size / 2**20:.0f} MiB"
