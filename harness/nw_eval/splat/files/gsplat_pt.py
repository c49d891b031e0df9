"""A gsplat training checkpoint: a torch file with `splats`, or their state dict itself.

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

from nw_eval.clean import clean
from nw_eval.errors import PrerequisiteError, SceneError
from nw_eval.splat.gaussians import SH_COUNTS, Gaussians

_KEYS = ("means", "scales", "quats", "opacities", "sh0", "shN")
_FIX = "give a checkpoint of gsplat's simple_trainer"
_MEMBERS = re.compile(
    r"data\.pkl|data/[0-9]+|version|byteorder|\.format_version|\.storage_alignment"
    r"|\.data/serialization_id"
)
"""What torch.save writes, below one folder. Torch's reader ignores case: another one would not."""


def read_gsplat_pt(path: Path) -> Gaussians:
    """Read a gsplat checkpoint.

    Raises:
        SceneError: when it is damaged or lacks a key.
        PrerequisiteError: without torch.
    """
    _check_archive(path)
    torch = _torch(path)
    try:
        content: Any = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises whatever its unpickler meets.
        first = str(error).strip().splitlines()[:1] or [type(error).__name__]
        raise SceneError(f"{path}: torch cannot load it: {first[0][:120]}", fix=_FIX) from error
    if isinstance(content, dict) and isinstance(content.get("splats"), dict):
        content = content["splats"]
    size = path.stat().st_size
    arrays = {key: _array(path, content, key, torch.Tensor, size) for key in _KEYS}
    n = len(arrays["means"])
    try:
        sh = np.concatenate([arrays["sh0"].reshape(n, 1, 3), arrays["shN"].reshape(n, -1, 3)], 1)
    except ValueError as error:
        raise SceneError(f"{path}: sh0 and shN do not fit {n} Gaussians", fix=_FIX) from error
    return Gaussians(
        means=arrays["means"],
        log_scales=arrays["scales"],
        quats=arrays["quats"],
        opacity_logits=arrays["opacities"].reshape(-1),
        sh=sh,
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
