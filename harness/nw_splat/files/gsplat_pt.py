"""A gsplat training checkpoint: a torch file with `splats`, or their state dict itself.

A training on several GPUs writes a file for each, `ckpt_29999_rank0.pt` and so on, and each holds
its share of the Gaussians: all that lie side by side are read.

Keys means (N, 3), scales (N, 3) logarithms, quats (N, 4) w x y z, opacities (N,) logits, sh0
(N, 1, 3), shN (N, K, 3). Loaded with weights_only: no code of the file runs.
"""

from __future__ import annotations

import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_base.clean import clean
from nw_base.errors import PrerequisiteError, SceneError
from nw_base.files.inside import OutsideError, inside
from nw_splat.files.format import SplatFormat
from nw_splat.gaussians import SH_COUNTS, Gaussians, check_count, concatenate

_KEYS = ("means", "scales", "quats", "opacities", "sh0", "shN")
_OF_TRAINING = ("splats", "step", "optimizers", "schedulers", "pose_adjust")
"""What goes on with a training, and how it moved cameras; no Gaussian changes by it."""
_FIX = "give a checkpoint of gsplat's simple_trainer"
_RANK = re.compile(r"(?P<step>ckpt_[0-9]+)_rank(?P<rank>[0-9]{1,4})\.pt")
EXPORT = "run `ns-export gaussian-splat` and give the folder that it writes"
_MEMBERS = re.compile(
    r"data\.pkl|data/[0-9]+|version|byteorder|\.format_version|\.storage_alignment"
    r"|\.data/serialization_id"
)
"""What torch.save writes, below one folder. Torch's reader ignores case: another one would not."""


def rank_files(path: Path) -> tuple[Path, ...]:
    """Return the files of all ranks beside a rank's file, in order; else the file alone.

    Raises:
        SceneError: a rank below one that is there is missing, or leads out of the folder.
    """
    mine = _RANK.fullmatch(path.name)
    if mine is None:
        return (path,)
    by_rank: dict[int, str] = {}
    for one in sorted(path.parent.glob(f"{mine['step']}_rank*.pt")):
        other = _RANK.fullmatch(one.name)
        if other is not None:
            by_rank[int(other["rank"])] = one.name
    lost = sorted(set(range(max(by_rank, default=0))) - set(by_rank))
    if lost:
        names = ", ".join(f"{mine['step']}_rank{rank}.pt" for rank in lost[:5])
        raise SceneError(
            f"{path}: it holds the share of one GPU, and {names} of the same step "
            f"{'is' if len(lost) == 1 else 'are'} missing",
            fix="put the files of all ranks side by side",
        )
    if len(by_rank) < 2:
        return (path,)
    try:
        return tuple(inside(path.parent, by_rank[rank]) for rank in sorted(by_rank))
    except OutsideError as error:
        raise SceneError(f"{path}: {error}", fix="put the files of all ranks there") from None


def read_gsplat_pt(path: Path) -> Gaussians:
    """Read a gsplat checkpoint, and the other ranks of its step that lie beside it.

    Raises:
        SceneError: when it is damaged or lacks a key, or a rank is missing.
        PrerequisiteError: without torch.
    """
    parts = [_read_one(one) for one in rank_files(path)]
    check_count(path, sum(map(len, parts)))
    return concatenate(*parts)


def _read_one(path: Path) -> Gaussians:
    if path.suffix.lower() == ".ckpt":
        raise SceneError(
            f"{path}: a training checkpoint of nerfstudio, which is not read", fix=EXPORT
        )
    _check_archive(path)
    torch = _torch(path)
    try:
        content: Any = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises whatever its unpickler meets.
        first = str(error).strip().splitlines()[:1] or [type(error).__name__]
        raise SceneError(f"{path}: torch cannot load it: {first[0][:120]}", fix=_FIX) from error
    notes: list[str] = []
    if isinstance(content, dict) and isinstance(content.get("splats"), dict):
        others = [str(key) for key in content if key not in _OF_TRAINING]
        if others:
            notes.append(f"keys that are not read: {clean(', '.join(others), at_most=200)}")
        content = content["splats"]
    if isinstance(content, dict) and "pipeline" in content:
        raise SceneError(
            f"{path}: a training checkpoint of nerfstudio, which is not read", fix=EXPORT
        )
    if isinstance(content, dict) and "features" in content and "sh0" not in content:
        raise SceneError(
            f"{path}: trained with --app_opt: its colours come from a network that is not read",
            fix="train without it",
        )
    size = path.stat().st_size
    arrays = {key: _array(path, content, key, torch.Tensor, size) for key in _KEYS}
    n = len(arrays["means"])
    try:
        sh = np.concatenate([arrays["sh0"].reshape(n, 1, 3), arrays["shN"].reshape(n, -1, 3)], 1)
    except ValueError as error:
        raise SceneError(f"{path}: sh0 and shN do not fit {n} Gaussians", fix=_FIX) from error
    left = ", ".join(clean(str(key), at_most=40) for key in content if key not in _KEYS)
    return Gaussians(
        means=arrays["means"],
        log_scales=arrays["scales"],
        quats=arrays["quats"],
        opacity_logits=arrays["opacities"].reshape(-1),
        sh=sh,
        notes=(*notes, *([f"keys of its Gaussians that are not read: {left}"] if left else [])),
    )


def write_gsplat_pt(path: Path, gaussians: Gaussians) -> None:
    """Write a gsplat checkpoint; exact.

    Harmonics are filled up with zeros to degree 3: trainers keep so many, and who renders their
    checkpoints asks for so many.

    Raises:
        PrerequisiteError: without torch.
    """
    torch = _torch(path)
    sh = np.pad(gaussians.sh, ((0, 0), (0, SH_COUNTS[-1] - gaussians.sh.shape[1]), (0, 0)))
    arrays = {
        "means": gaussians.means,
        "scales": gaussians.log_scales,
        "quats": gaussians.quats,
        "opacities": gaussians.opacity_logits,
        "sh0": sh[:, :1],
        "shN": sh[:, 1:],
    }
    # Copies: a view would be stored with all that lies under it.
    splats = {key: torch.tensor(array) for key, array in arrays.items()}
    # A step, because trainers ask for it; of none. Into an open file, so that its bytes do not
    # depend on the name.
    with path.open("wb") as file:
        torch.save({"step": 0, "splats": splats}, file)


def _is_torch(path: Path) -> bool:
    """Return whether a zip archive may be torch's: it has its pickle, or the suffix."""
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError):
        names = []
    return path.suffix.lower() in {".pt", ".pth", ".ckpt"} or any(
        name.endswith("data.pkl") for name in names
    )


def _torch(path: Path) -> Any:
    try:
        import torch
    except ImportError as error:
        raise PrerequisiteError(f"{path}: needs torch", fix="pip install torch") from error
    return torch


def _check_archive(path: Path) -> None:
    """Refuse archives that expand, or that two readers may read as two: torch writes neither."""
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
    except (zipfile.BadZipFile, ValueError, NotImplementedError, EOFError) as error:
        raise SceneError(f"{path}: damaged archive: {error}", fix=_FIX) from error
    stored = all(entry.compress_type == zipfile.ZIP_STORED for entry in entries)
    if not stored or sum(entry.file_size for entry in entries) > path.stat().st_size:
        raise SceneError(f"{path}: archive with compressed or overlapping entries", fix=_FIX)
    roots = {entry.filename.partition("/")[0] for entry in entries}
    names = [entry.filename.partition("/")[2] for entry in entries]
    odd = [name for name in names if not _MEMBERS.fullmatch(name)]
    if len(roots) != 1 or odd or len(set(names)) != len(names):
        what = f"member {clean(odd[0], at_most=100)!r}" if odd else "members of several files"
        raise SceneError(f"{path}: archive with {what}, as torch.save never writes it", fix=_FIX)


def _array(path: Path, content: Any, key: str, tensor_type: type, size: int) -> NDArray[np.float32]:
    tensor = content.get(key) if isinstance(content, dict) else None
    if tensor is None and key == "shN" and isinstance(content, dict):
        return np.zeros((0,), dtype=np.float32)
    if not isinstance(tensor, tensor_type):
        raise SceneError(f"{path}: has no tensor {key!r}", fix=_FIX)
    values: Any = tensor
    # A tensor of stride 0 can claim any shape; its elements must be in the file.
    if values.layout.__str__() != "torch.strided" or values.numel() > size:
        raise SceneError(
            f"{path}: tensor {key!r} of shape {tuple(values.shape)} holds no data", fix=_FIX
        )
    if not values.is_floating_point():
        raise SceneError(f"{path}: tensor {key!r} is {values.dtype}", fix=_FIX)
    return values.detach().float().numpy()


GSPLAT_PT = SplatFormat(
    name="pt",
    description="a gsplat training checkpoint, with the other ranks of its step beside it",
    read=read_gsplat_pt,
    write=write_gsplat_pt,
    sniff=lambda path, mark: mark[:4] == b"PK\x03\x04" and _is_torch(path),
)
