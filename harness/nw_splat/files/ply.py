"""Splats in PLY files (3DGS's own, SuperSplat's compressed one, nerfstudio's export) and .splat.

**3DGS** has one row of floats for each Gaussian. Columns x y z, f_dc_0..2, f_rest_0.., opacity
(logit), scale_0..2 (logarithms), rot_0..3 (w x y z); found by name, others are noted.
f_rest comes in two arrangements. Everyone's is channel-major: all red coefficients, then green,
then blue. The
published Neverwhere toolchain writes coefficient-major: red, green, blue of the first coefficient,
then of the second. Nothing in such a file says so, but the three channels of a coefficient resemble
one another much more than any other three values, which tells the two apart.

A comment `SplatRenderMode: default | mip` (Brush) says whether they were trained classic or
antialiased, and one `SplatProjection=ewa | ray` (nw-eval) how they became pixels in training. A
column filter_3D (Mip-Splatting, https://arxiv.org/abs/2311.16493, section 4.1) is a
smoothing that was applied while training: it is folded into scales and opacities.

**SuperSplat's compressed PLY** has 16 bytes per Gaussian, quantised within chunks of 256. Element
chunk holds the ranges of position, log scale and (in newer files) colour; element vertex holds
packed_position and packed_scale (11-10-11 bits), packed_rotation (2 bits which component is
largest, 3x10 bits the others in +-1/sqrt(2)) and packed_color (8888, alpha is opacity); element sh,
when present, one byte per coefficient over +-4. After PlayCanvas's reader of the format.

**A splatfacto export of nerfstudio** is a folder. dataparser_transforms.json holds
{"transform": 3x4 [R | t], "scale": s} with x_trainer = s (R x_capture + t). The exporter leaves
splat.ply in the trainer's frame; reading the folder brings it back to the frame of the capture
(COLMAP's or the device's).

**.splat** has 32 bytes per Gaussian, no harmonics above the constant: float32 position (3), float32
standard deviations (3), uint8 red green blue opacity, uint8 quaternion w x y z as 128 + 128 q.
Lossy: colour is clamped to 0..1 and all but position and size keep eight bits.
"""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Literal, TypedDict

import numpy as np
from numpy.typing import NDArray

from nw_base import same_bits
from nw_base.clean import clean
from nw_base.errors import SceneError
from nw_base.files.inside import regular
from nw_base.files.ply import Ply
from nw_base.words import PROJECTIONS, Projection, RasterizeMode
from nw_splat.files.format import SplatFormat
from nw_splat.gaussians import (
    SH0,
    SH_COUNTS,
    Gaussians,
    check_count,
    logit,
    sigmoid,
    to_byte,
    transformed,
    unit_quats,
)

RestOrder = Literal["detect", "channel", "coefficient"]
"""How f_rest is arranged: channel-major, coefficient-major, or to be found out."""

_SAMPLE = 20_000
_MARGIN = 0.8
_COMMENT = "f_rest order: channel"
_MODES: dict[str, RasterizeMode] = {"default": "classic", "mip": "antialiased"}
_PROJECTIONS: dict[str, Projection] = {name: name for name in PROJECTIONS}

_CHUNK = 256
_THREE = ((21, 11), (11, 10), (0, 11))

_TRANSFORM_BYTES = 1_000_000
_REACH = 1e6  # of every number, either way
TRANSFORMS = "dataparser_transforms.json"
_FIX_EXPORT = (
    "give the folder that `ns-export gaussian-splat` wrote, with that file beside splat.ply"
)


class _Marks(TypedDict):
    rasterize_mode: RasterizeMode | None
    projection: Projection | None


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
    marks = marks_of(ply)
    if "filter_3D" in names:
        filters = ply.columns("vertex", ["filter_3D"])
        log_scales, opacity_logits = _smoothed(log_scales, opacity_logits, filters)
        marks["rasterize_mode"] = marks["rasterize_mode"] or "antialiased"
    return Gaussians(
        means=ply.columns("vertex", ["x", "y", "z"]),
        log_scales=log_scales,
        quats=ply.columns("vertex", ["rot_0", "rot_1", "rot_2", "rot_3"]),
        opacity_logits=opacity_logits,
        sh=sh,
        notes=_unread(ply),
        **marks,
    )


_READ = re.compile(
    r"[xyz]|f_dc_[012]|f_rest_\d+|opacity|scale_[012]|rot_[0123]|filter_3D"
    r"|(min|max)_((scale_)?[xyz]|[rgb])|packed_(position|rotation|scale|color)"
)
_NO_EFFECT = ("nx", "ny", "nz", "red", "green", "blue", "alpha")
"""Normals, which 3DGS writes as zeros, and a preview of f_dc for viewers of points."""
_SAID = re.compile(
    rf"SplatRenderMode[\s:=]+({'|'.join(_MODES)})|SplatProjection[\s:=]+({'|'.join(_PROJECTIONS)})"
    rf"|{_COMMENT}"
)


def _unread(ply: Ply) -> tuple[str, ...]:
    """Return what of a file is not read, by name: elements, properties, comments."""
    notes: list[str] = []
    for element, table in ply.elements.items():
        if element not in {"vertex", *(("chunk", "sh") if "chunk" in ply.elements else ())}:
            notes.append(f"element that is not read: {clean(element, at_most=40)}, {len(table)}")
        else:
            used = [one for one in table.dtype.names or () if _READ.fullmatch(one)]
            notes += ply.remarks(element, used, _NO_EFFECT)
    return (*notes, *ply.unread_comments(_SAID))


def marks_of(ply: Ply) -> _Marks:
    """Return what comments say of the training of the Gaussians."""
    said = [re.split(r"[\s:=]+", comment.strip(), maxsplit=1) for comment in ply.comments]
    tags = {words[0]: words[1].lower() for words in reversed(said) if len(words) == 2}
    return {
        "rasterize_mode": _MODES.get(tags.get("SplatRenderMode", "")),
        "projection": _PROJECTIONS.get(tags.get("SplatProjection", "")),
    }


def _smoothed(
    log_scales: NDArray[np.float32], logits: NDArray[np.float32], filters: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return scales and opacities of Gaussians (N, 3), (N,) after a filter (N, 1), in scene units.

    Variances grow by the filter's, opacity falls as the volume grows.
    """
    with np.errstate(all="ignore"):
        before = same_bits.exp(2 * log_scales.astype(np.float64))
        after = before + filters.astype(np.float64) ** 2
        share = np.sqrt(np.where(after > 0, before / after, 1.0).prod(axis=1))
        opacity = share / (1 + same_bits.exp(-logits.astype(np.float64)))
        return (
            (0.5 * same_bits.log(after)).astype(np.float32),
            same_bits.log(opacity / (1 - opacity)).astype(np.float32),
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
        *(
            []
            if gaussians.projection is None
            else [f"comment SplatProjection={gaussians.projection}"]
        ),
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
        notes=_unread(ply),
        **marks_of(ply),
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
        places = [index for index in range(4) if index != component]
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


def read_nerfstudio(folder: Path, *, rest_order: RestOrder = "detect") -> Gaussians:
    """Read a splatfacto export in the frame of the capture.

    Raises:
        SceneError: when a part is missing or the transform is no similarity.
    """
    clouds = sorted(folder.glob("*.ply"))
    cloud = folder / "splat.ply" if folder / "splat.ply" in clouds else None
    if cloud is None and len(clouds) == 1:
        cloud = clouds[0]
    if cloud is None:
        raise SceneError(f"{folder}: {len(clouds)} .ply files, none is splat.ply", fix=_FIX_EXPORT)
    T_trainer_capture = _read_transform(folder / TRANSFORMS)
    gaussians = read_threedgs_ply(Ply.open(regular(cloud)), rest_order=rest_order)
    return transformed(gaussians, np.linalg.inv(T_trainer_capture).astype(np.float64))


def _read_transform(path: Path) -> NDArray[np.float64]:
    """(4, 4) of a similarity from capture to trainer."""
    try:
        if regular(path).stat().st_size > _TRANSFORM_BYTES:
            raise SceneError(f"{path}: too large", fix="it holds one 3 x 4 matrix and a scale")
        content = json.loads(path.read_text(encoding="utf-8"))
        matrix = np.array(content["transform"], dtype=np.float64)
        scale = float(content["scale"])
    except OSError as error:
        raise SceneError(f"{path}: {error.strerror or error}", fix=_FIX_EXPORT) from error
    except (ArithmeticError, LookupError, RecursionError, TypeError, ValueError) as error:
        raise SceneError(
            f"{path}: no transform and scale in it ({error!r})", fix=_FIX_EXPORT
        ) from error
    if matrix.shape not in ((3, 4), (4, 4)) or not (np.abs(matrix) <= _REACH).all():
        raise SceneError(f"{path}: transform has shape {matrix.shape}", fix="it must be 3x4")
    if not 1 / _REACH <= scale <= _REACH:
        raise SceneError(f"{path}: scale is {scale}", fix="it must be positive")
    T = np.eye(4)
    T[:3] = scale * matrix[:3]
    if abs(np.linalg.det(T)) < _REACH**-3:
        raise SceneError(f"{path}: transform flattens", fix="it must be a rotation and a shift")
    return T


def read_ply(path: Path) -> Gaussians:
    """Read a PLY file, 3DGS's own or SuperSplat's compressed one.

    Raises:
        SceneError: as `read_threedgs_ply` and `read_compressed_ply`.
    """
    ply = Ply.open(path)
    if "chunk" in ply.elements:
        return read_compressed_ply(ply)
    return read_threedgs_ply(ply)


PLY = SplatFormat(
    name="ply",
    description="3DGS (gsplat, splatfacto, Polycam, SuperSplat), and SuperSplat's compressed form",
    read=read_ply,
    write=write_threedgs_ply,
    sniff=lambda _, mark: mark[:3] == b"ply",
)


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
        log_scales = same_bits.log(np.maximum(np.abs(rows["scale"]), np.float32(_LEAST_SCALE)))
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
        order = np.argsort(
            -same_bits.exp(gaussians.log_scales.sum(axis=1)) * opacity, kind="stable"
        )
        rows = np.empty(len(gaussians), _ROW)
        rows["mean"] = gaussians.means[order]
        rows["scale"] = same_bits.exp(gaussians.log_scales[order])
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
