"""What a file is, by its bytes and not by its name."""

from __future__ import annotations

import io
import zipfile
from typing import Literal

from nw_eval.clean import clean
from nw_eval.errors import PolicyError
from nw_eval.policies.safety.archive import ZIP_FAULTS

FileKind = Literal["onnx", "state-dict", "torchscript", "torch-export", "safetensors", "unknown"]

_SAID: dict[FileKind, str] = {
    "onnx": "it is an ONNX graph",
    "state-dict": "it holds a state dict or other plain objects",
    "torchscript": "it is a TorchScript file",
    "torch-export": "it is a torch.export file",
    "safetensors": "it is a safetensors file",
    "unknown": "its format is unknown",
}

_TEXTS = (b"<!doctype", b"<html", b"<?xml")


def file_kind(data: bytes, where: str) -> FileKind:
    """Say what a checkpoint is.

    Args:
        data: the whole file.
        where: its path, for errors.

    Raises:
        PolicyError: it is no checkpoint at all, and it can be said what it is instead: nothing, a
            web page, a pointer of Git LFS, a bare pickle, another archive.
    """
    if not data:
        raise PolicyError(f"{where}: the file is empty", fix="copy or download it again")
    head = data[:512]
    if head.lstrip().lower().startswith(_TEXTS):
        raise PolicyError(
            f"{where}: this is a web page, not a checkpoint",
            fix="download the file itself: the link led to a page or a login",
        )
    if head.startswith(b"version https://git-lfs"):
        raise PolicyError(
            f"{where}: this is a pointer of Git LFS, not the checkpoint",
            fix="run `git lfs pull`",
        )
    if head.startswith(b"PK"):
        return _archive_kind(data, where)
    if head[:1] == b"\x80" and len(head) > 1 and head[1] <= 5:
        raise PolicyError(
            f"{where}: this is a bare pickle (torch before 1.6, or `pickle.dump`), which could run "
            "code and is never opened",
            fix="load it where you trust it and save it with `torch.save(state_dict, file)`",
        )
    if head.startswith(b"\x1f\x8b") or data[257:262] == b"ustar":
        raise PolicyError(
            f"{where}: this is a gzip or tar archive", fix="unpack it and give the file inside"
        )
    if _is_safetensors(data):
        return "safetensors"
    # ModelProto begins with its field 1, the varint `ir_version`: 3 to some small number.
    if head[:1] == b"\x08" and len(head) > 2 and 1 <= head[1] <= 32:
        return "onnx"
    return "unknown"


def kind_said(kind: FileKind) -> str:
    """Return a kind as an error says it: "it is a TorchScript file"."""
    return _SAID[kind]


def _archive_kind(data: bytes, where: str) -> FileKind:
    try:
        names = zipfile.ZipFile(io.BytesIO(data)).namelist()
    except ZIP_FAULTS as error:
        raise PolicyError(
            f"{where}: the archive is truncated or damaged: {clean(error, at_most=200)}",
            fix="copy or download the file again",
        ) from None
    leaves = {name.split("/", 1)[-1] for name in names}
    if "archive_format" in leaves or "serialized_exported_program.json" in names:
        return "torch-export"
    if "data.pkl" in leaves:
        return "torchscript" if "constants.pkl" in leaves else "state-dict"
    return "unknown"


def _is_safetensors(data: bytes) -> bool:
    size = int.from_bytes(data[:8], "little")
    return data[8:9] == b"{" and 2 <= size <= len(data) - 8
