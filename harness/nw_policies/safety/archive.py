"""Archives: members are checked all together before any of them is unpacked.

The type of a file is determined by its bytes, not by its name.
"""

from __future__ import annotations

import io
import re
import stat
import struct
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Literal

from nw_base.clean import clean
from nw_base.errors import PolicyError

_ZIP_FAULTS = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    EOFError,
    OSError,
    ValueError,
    RuntimeError,  # NotImplementedError too: a compression or encryption that it lacks.
)
"""What Python's zip reader raises about damaged archives."""
FileKind = Literal[
    "onnx",
    "state-dict",
    "torchscript",
    "torch-export",
    "safetensors",
    "stable-baselines3",
    "pickle",
    "msgpack",
    "unknown",
]

_SAID: dict[FileKind, str] = {
    "onnx": "it is an ONNX graph",
    "state-dict": "it holds a state dict or other plain objects",
    "torchscript": "it is a TorchScript file",
    "torch-export": "it is a torch.export file",
    "safetensors": "it is a safetensors file",
    "stable-baselines3": "it is a zip file of Stable-Baselines3",
    "pickle": "it is a bare pickle, as brax saves parameters",
    "msgpack": "it is a msgpack file, as flax saves parameters",
    "unknown": "its format is unknown",
}

_OLD_TORCH = b"\x80\x02\x8a\x0a\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19"
"""A pickle of the number that torch began its files with."""
_MSGPACK = re.compile(rb"([\x81-\x8f]|\xde..)([\xa1-\xbf]|\xd9.)[\x20-\x7e]", re.DOTALL)
"""A map whose first key is a text."""
_TEXTS = (b"<!doctype", b"<html", b"<?xml")


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
        except _ZIP_FAULTS as error:
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
    except _ZIP_FAULTS as error:
        raise PolicyError(
            f"{where}: not an archive, or a truncated one: {clean(error, at_most=200)}",
            fix="copy or download the file again",
        ) from None
    if len(members) > limits.members:
        raise PolicyError(
            f"{where}: the archive has {len(members)} members, over the limit of {limits.members}",
            fix="export the actor alone",
        )
    if min((member.header_offset for member in members), default=0) > 0:
        raise PolicyError(
            f"{where}: the archive begins behind other bytes: readers may disagree about it",
            fix="do not use this file; export the policy again",
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


def file_kind(data: bytes, where: str) -> FileKind:
    """Return the type of a checkpoint.

    Args:
        data: the whole file.
        where: its path, for errors.

    Raises:
        PolicyError: it is no checkpoint at all, and it can be said what it is instead: nothing, a
            web page, a pointer of Git LFS, a file of torch before 1.6, another archive.
    """
    head = data[:512]
    _refuse_others(data, head, where)
    if head.startswith(b"PK"):
        return _archive_kind(data, where)
    if head[:1] == b"\x80" and len(head) > 1 and head[1] <= 5:
        return "pickle"
    if _is_safetensors(data):
        return "safetensors"
    if _MSGPACK.match(head):
        return "msgpack"
    # ModelProto begins with its field 1, the varint `ir_version`: 3 to some small number.
    if head[:1] == b"\x08" and len(head) > 2 and 1 <= head[1] <= 32:
        return "onnx"
    return "unknown"


def _refuse_others(data: bytes, head: bytes, where: str) -> None:
    if not data:
        raise PolicyError(f"{where}: the file is empty", fix="copy or download it again")
    if head.lstrip().lower().startswith(_TEXTS):
        raise PolicyError(
            f"{where}: this is a web page, not a checkpoint",
            fix="download the file itself: the link leads to a web page or a login",
        )
    if head.startswith(b"version https://git-lfs"):
        raise PolicyError(
            f"{where}: this is a pointer of Git LFS, not the checkpoint",
            fix="run `git lfs pull`",
        )
    if head.startswith(_OLD_TORCH):
        raise PolicyError(
            f"{where}: this is a file of torch before 1.6, a row of pickles, which is never opened",
            fix="load it where you trust it and save it with `torch.save(state_dict, file)`",
        )
    if head.startswith(b"\x1f\x8b") or data[257:262] == b"ustar":
        raise PolicyError(
            f"{where}: this is a gzip or tar archive", fix="unpack it and give the file inside"
        )


def kind_said(kind: FileKind) -> str:
    """Return a kind as an error says it: "it is a TorchScript file"."""
    return _SAID[kind]


def _archive_kind(data: bytes, where: str) -> FileKind:
    try:
        names = zipfile.ZipFile(io.BytesIO(data)).namelist()
    except _ZIP_FAULTS as error:
        raise PolicyError(
            f"{where}: the archive is truncated or damaged: {clean(error, at_most=200)}",
            fix="copy or download the file again",
        ) from None
    leaves = {name.split("/", 1)[-1] for name in names}
    if "archive_format" in leaves or "serialized_exported_program.json" in names:
        return "torch-export"
    if "policy.pth" in names and "data" in names:
        return "stable-baselines3"
    if "data.pkl" in leaves:
        return "torchscript" if "constants.pkl" in leaves else "state-dict"
    return "unknown"


def _is_safetensors(data: bytes) -> bool:
    size = int.from_bytes(data[:8], "little")
    return data[8:9] == b"{" and 2 <= size <= len(data) - 8


@dataclass(frozen=True, kw_only=True)
class FileLimits:
    """Bounds that are checked before memory is allocated.

    The largest policy of this field has some 100 MB; these leave room, and no more than that.
    """

    file_bytes: int = 2**30
    """Size of the file itself."""
    members: int = 20_000
    """Members of an archive."""
    unpacked_bytes: int = 2**30
    """Sum of the members' sizes after decompression."""
    compression: int = 200
    """Largest ratio of unpacked to packed size of a member; a bomb has 1000."""
    index_bytes: int = 2**24
    """The pickled index of a torch file, or the JSON of a graph."""
    pickle_bytes: int = 2**28
    """A pickle or msgpack file that holds its numbers itself."""
    tensors: int = 20_000
    """Number of tensors."""
    tensor_bytes: int = 2**30
    """Sum of the sizes of all tensors, counted one by one: views of one storage count each."""
    nodes: int = 20_000
    """Nodes of a graph, calls of functions written out."""
    depth: int = 64
    """Nesting of dicts and lists."""
