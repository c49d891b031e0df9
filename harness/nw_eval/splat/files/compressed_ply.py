"""SuperSplat's compressed PLY: 16 bytes per Gaussian, quantised within chunks of 256.

Element chunk holds the ranges of position, log scale and (in newer files) colour; element vertex
holds packed_position and packed_scale (11-10-11 bits), packed_rotation (2 bits which component is
largest, 3x10 bits the others in +-1/sqrt(2)) and packed_color (8888, alpha is opacity); element sh,
when present, one byte per coefficient over +-4. After PlayCanvas's reader of the format.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import SceneError
from nw_eval.files.ply import Ply
from nw_eval.splat.files.quantise import logit
from nw_eval.splat.files.threedgs_ply import mode_of
from nw_eval.splat.gaussians import SH0, SH_COUNTS, Gaussians, check_count

_CHUNK = 256
_THREE = ((21, 11), (11, 10), (0, 11))


def read_compressed_ply(ply: Ply) -> Gaussians:
    """Read a compressed PLY file.

    Raises:
        SceneError: for missing parts or too few chunks.
    """
    for element in ("chunk", "vertex"):
        if element not in ply.elements:
            raise SceneError(f"{ply.path}: has no element {element}", fix="export the file again")
    n, chunks = len(ply.elements["vertex"]), len(ply.elements["chunk"])
    check_count(ply.path, n)
    if chunks * _CHUNK < n:
        raise SceneError(
            f"{ply.path}: {chunks} chunks for {n} Gaussians, {-(-n // _CHUNK)} are needed",
            fix="export the file again",
        )
    chunk = np.arange(n) // _CHUNK
    position = _unpack(_packed(ply, "packed_position"), _THREE)
    scale = _unpack(_packed(ply, "packed_scale"), _THREE)
    colour = _unpack(_packed(ply, "packed_color"), ((24, 8), (16, 8), (8, 8), (0, 8)))
    rgb = colour[:, :3]
    if "min_r" in (ply.elements["chunk"].dtype.names or ()):
        rgb = _scaled(ply, rgb, chunk, "min_{}", "max_{}", "rgb")
    dc = (rgb - np.float32(0.5)) / np.float32(SH0)
    return Gaussians(
        means=_scaled(ply, position, chunk, "min_{}", "max_{}", "xyz"),
        log_scales=_scaled(ply, scale, chunk, "min_scale_{}", "max_scale_{}", "xyz"),
        quats=_quats(_packed(ply, "packed_rotation")),
        opacity_logits=logit(colour[:, 3]),
        sh=np.concatenate([dc[:, None], _rest(ply, n)], axis=1),
        rasterize_mode=mode_of(ply),
    )


def _packed(ply: Ply, name: str) -> NDArray[np.uint32]:
    table = ply.elements["vertex"]
    if name not in (table.dtype.names or ()) or table.dtype[name].kind != "u":
        raise SceneError(f"{ply.path}: vertex has no uint {name}", fix="export the file again")
    return np.asarray(table[name], dtype=np.uint32)


def _unpack(packed: NDArray[np.uint32], fields: tuple[tuple[int, int], ...]) -> NDArray[np.float32]:
    """(n, fields) float32 in 0..1 of the (shift, bits) fields."""
    out = np.empty((len(packed), len(fields)), dtype=np.float32)
    for i, (shift, bits) in enumerate(fields):
        most = (1 << bits) - 1
        out[:, i] = ((packed >> np.uint32(shift)) & np.uint32(most)) / most
    return out


def _scaled(
    ply: Ply,
    unit: NDArray[np.float32],
    chunk: NDArray[np.int64],
    low: str,
    high: str,
    axes: str,
) -> NDArray[np.float32]:
    least = ply.columns("chunk", [low.format(axis) for axis in axes])[chunk]
    most = ply.columns("chunk", [high.format(axis) for axis in axes])[chunk]
    with np.errstate(over="ignore", invalid="ignore"):
        return (least * (1 - unit) + most * unit).astype(np.float32)


def _quats(packed: NDArray[np.uint32]) -> NDArray[np.float32]:
    largest = packed >> np.uint32(30)
    others = (_unpack(packed, ((20, 10), (10, 10), (0, 10))) - np.float32(0.5)) * math.sqrt(2.0)
    rest = np.sqrt(np.maximum(0.0, 1.0 - (others * others).sum(axis=1)))
    quats = np.empty((len(packed), 4), dtype=np.float32)
    for component in range(4):
        rows = np.flatnonzero(largest == component)
        places = [place for place in range(4) if place != component]
        quats[rows, component] = rest[rows]
        quats[rows[:, None], places] = others[rows]
    return quats


def _rest(ply: Ply, n: int) -> NDArray[np.float32]:
    table = ply.elements.get("sh")
    if table is None:
        return np.zeros((n, 0, 3), dtype=np.float32)
    names = [name for name in table.dtype.names or () if name.startswith("f_rest_")]
    count = len(names) // 3
    if len(names) % 3 or count + 1 not in SH_COUNTS or len(table) != n:
        raise SceneError(
            f"{ply.path}: element sh has {len(table)} rows of {len(names)} for {n} Gaussians",
            fix="export the file again",
        )
    values = ply.columns("sh", [f"f_rest_{i}" for i in range(len(names))])
    values = ((values + np.float32(0.5)) / 256 - np.float32(0.5)) * 8
    return values.reshape(n, 3, count).transpose(0, 2, 1).astype(np.float32)
