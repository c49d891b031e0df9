"""The PLY file of 3DGS: one row of floats for each Gaussian.

Columns x y z, f_dc_0..2, f_rest_0.., opacity (logit), scale_0..2 (logarithms), rot_0..3 (w x y z);
found by name, others ignored. f_rest comes in two arrangements. Everyone's is channel-major: all
red coefficients, then green, then blue. The published Neverwhere toolchain writes
coefficient-major: red, green, blue of the first coefficient, then of the second. Nothing in such
a file says so, but the three channels of a coefficient resemble one another much more than any
other three values, which tells the two apart.

A comment `SplatRenderMode: default | mip` (Brush) says whether they were trained classic or
antialiased. A column filter_3D (Mip-Splatting, https://arxiv.org/abs/2311.16493, section 4.1) is a
smoothing that was applied while training: it is folded into scales and opacities.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import SceneError
from nw_eval.files.ply import Ply
from nw_eval.splat.gaussians import SH_COUNTS, Gaussians, check_count
from nw_eval.words import RasterizeMode

RestOrder = Literal["detect", "channel", "coefficient"]
"""How f_rest is arranged: channel-major, coefficient-major, or to be found out."""

_SAMPLE = 20_000
_MARGIN = 0.8
_COMMENT = "f_rest order: channel"
_MODES: dict[str, RasterizeMode] = {"default": "classic", "mip": "antialiased"}


def read_threedgs_ply(ply: Ply, *, rest_order: RestOrder = "detect") -> Gaussians:
    """Read a 3DGS PLY file.

    Raises:
        SceneError: for missing columns or a number of f_rest that is no degree of harmonics.
    """
    if "vertex" not in ply.elements:
        raise SceneError(f"{ply.path}: has no element vertex", fix="give a Gaussian splat")
    names = ply.elements["vertex"].dtype.names or ()
    if {"scale_0", "scale_1", "rot_0"} <= set(names) and "scale_2" not in names:
        raise SceneError(
            f"{ply.path}: discs of 2DGS (scale_0 and scale_1 alone), which are drawn by another "
            "rule than Gaussians",
            fix="train the scene as 3DGS",
        )
    rest = sum(1 for name in names if re.fullmatch(r"f_rest_\d+", name))
    if rest % 3 or rest // 3 + 1 not in SH_COUNTS:
        raise SceneError(
            f"{ply.path}: {rest} f_rest properties", fix="0, 9, 24 or 45 make degree 0, 1, 2 or 3"
        )
    n = len(ply.elements["vertex"])
    check_count(ply.path, n)
    sh = np.empty((n, 1 + rest // 3, 3), dtype=np.float32)
    sh[:, 0] = ply.columns("vertex", ["f_dc_0", "f_dc_1", "f_dc_2"])
    if rest:
        rest_names = [f"f_rest_{i}" for i in range(rest)]
        if rest_order == "detect":
            sample = slice(None, None, max(1, n // _SAMPLE))
            rest_order = _detect(ply, ply.columns("vertex", rest_names, rows=sample))
        values = ply.columns("vertex", rest_names)
        if rest_order == "channel":
            sh[:, 1:] = values.reshape(n, 3, rest // 3).transpose(0, 2, 1)
        else:
            sh[:, 1:] = values.reshape(n, rest // 3, 3)
    log_scales = ply.columns("vertex", ["scale_0", "scale_1", "scale_2"])
    opacity_logits = ply.columns("vertex", ["opacity"])[:, 0]
    mode = mode_of(ply)
    if "filter_3D" in names:
        filters = ply.columns("vertex", ["filter_3D"])
        log_scales, opacity_logits = _smoothed(log_scales, opacity_logits, filters)
        mode = mode or "antialiased"
    return Gaussians(
        means=ply.columns("vertex", ["x", "y", "z"]),
        log_scales=log_scales,
        quats=ply.columns("vertex", ["rot_0", "rot_1", "rot_2", "rot_3"]),
        opacity_logits=opacity_logits,
        sh=sh,
        rasterize_mode=mode,
    )


def mode_of(ply: Ply) -> RasterizeMode | None:
    """Return what a comment says the Gaussians were trained for."""
    for comment in ply.comments:
        words = comment.replace(":", " ").split()
        if len(words) == 2 and words[0] == "SplatRenderMode":
            return _MODES.get(words[1].lower())
    return None


def _smoothed(
    log_scales: NDArray[np.float32], logits: NDArray[np.float32], filters: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return scales and opacities of Gaussians (N, 3), (N,) after a filter (N, 1), in scene units.

    Variances grow by the filter's, opacity falls as the volume grows.
    """
    with np.errstate(all="ignore"):
        before = np.exp(2 * log_scales.astype(np.float64))
        after = before + filters.astype(np.float64) ** 2
        share = np.sqrt((before / after).prod(axis=1))
        opacity = share / (1 + np.exp(-logits.astype(np.float64)))
        return (
            (0.5 * np.log(after)).astype(np.float32),
            np.log(opacity / (1 - opacity)).astype(np.float32),
        )


def _detect(ply: Ply, rest: NDArray[np.float32]) -> RestOrder:
    if _COMMENT in ply.comments:
        return "channel"
    values = rest[np.isfinite(rest).all(axis=1)].astype(np.float64)
    n, count = len(values), values.shape[1] // 3
    channel = _disagreement(values.reshape(n, 3, count).transpose(0, 2, 1))
    coefficient = _disagreement(values.reshape(n, count, 3))
    return "coefficient" if coefficient < _MARGIN * channel else "channel"


def _disagreement(sh: NDArray[np.float64]) -> float:
    """Variance among the three channels of each coefficient of (n, K, 3), summed."""
    with np.errstate(over="ignore", invalid="ignore"):
        return float(sh.var(axis=2).sum())


def write_threedgs_ply(path: Path, gaussians: Gaussians) -> None:
    """Write a 3DGS PLY file, channel-major; exact."""
    n, count = len(gaussians), gaussians.sh.shape[1]
    rest = 3 * (count - 1)
    names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2"]
    names += [f"f_rest_{i}" for i in range(rest)]
    names += ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment {_COMMENT}",
        *(f"comment SplatRenderMode: {m}" for m in _MODES if _MODES[m] == gaussians.rasterize_mode),
        f"element vertex {n}",
    ]
    header += [f"property float {name}" for name in names] + ["end_header", ""]
    with path.open("wb") as file:
        file.write("\n".join(header).encode("ascii"))
        # By parts, so that a file of gigabytes is not held twice.
        for start in range(0, n, 1 << 16):
            part = slice(start, start + (1 << 16))
            sh = gaussians.sh[part]
            columns = [
                gaussians.means[part],
                sh[:, 0],
                sh[:, 1:].transpose(0, 2, 1).reshape(len(sh), -1),
                gaussians.opacity_logits[part, None],
                gaussians.log_scales[part],
                gaussians.quats[part],
            ]
            file.write(np.concatenate(columns, axis=1, dtype="<f4").tobytes())
