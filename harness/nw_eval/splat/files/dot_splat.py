""".splat: 32 bytes per Gaussian, no harmonics above the constant.

float32 position (3), float32 standard deviations (3), uint8 red green blue opacity, uint8
quaternion w x y z as 128 + 128 q. Lossy: colour is clamped to 0..1 and all but position and size
keep eight bits.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from nw_eval.errors import SceneError
from nw_eval.splat.files.format import SplatFormat
from nw_eval.splat.gaussians import SH0, Gaussians, check_count, logit, sigmoid, to_byte, unit_quats

_ROW = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)])
_LEAST_SCALE = 1e-12


def read_dot_splat(path: Path) -> Gaussians:
    """Read a .splat file.

    Raises:
        SceneError: when it is empty or no whole number of rows.
    """
    size = path.stat().st_size
    if size == 0 or size % _ROW.itemsize:
        raise SceneError(
            f"{path}: {size} bytes are not a multiple of 32-byte rows",
            fix="the file is cut short or not a .splat file",
        )
    check_count(path, size // _ROW.itemsize)
    rows = np.fromfile(path, _ROW)
    rgba = rows["rgba"].astype(np.float32) / np.float32(255)
    with np.errstate(invalid="ignore"):
        log_scales = np.log(np.maximum(np.abs(rows["scale"]), np.float32(_LEAST_SCALE)))
    return Gaussians(
        means=rows["mean"],
        log_scales=log_scales,
        quats=(rows["quat"].astype(np.float32) - 128) / np.float32(128),
        opacity_logits=logit(rgba[:, 3]),
        sh=((rgba[:, :3] - np.float32(0.5)) / np.float32(SH0))[:, None],
    )


def write_dot_splat(path: Path, gaussians: Gaussians) -> None:
    """Write a .splat file, largest and most opaque first, as viewers of the format expect."""
    opacity = sigmoid(gaussians.opacity_logits)
    with np.errstate(over="ignore", invalid="ignore"):
        order = np.argsort(-np.exp(gaussians.log_scales.sum(axis=1)) * opacity, kind="stable")
        rows = np.empty(len(gaussians), _ROW)
        rows["mean"] = gaussians.means[order]
        rows["scale"] = np.exp(gaussians.log_scales[order])
    rows["rgba"][:, :3] = to_byte((gaussians.sh[order, 0] * SH0 + 0.5) * 255)
    rows["rgba"][:, 3] = to_byte(opacity[order] * 255)
    rows["quat"] = to_byte(unit_quats(gaussians.quats[order]) * 128 + 128)
    rows.tofile(path)


DOT_SPLAT = SplatFormat(
    name="splat",
    description="antimatter15's 32 bytes per Gaussian, no harmonics",
    read=read_dot_splat,
    write=write_dot_splat,
)
