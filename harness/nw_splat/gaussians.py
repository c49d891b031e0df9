"""A set of 3D Gaussians, in the form that training tools store.

Also here: its figures, its way from one frame to another with its harmonics, and the conversions
between opacities, logits and bytes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_base import same_bits
from nw_base.errors import SceneError
from nw_base.words import Projection, RasterizeMode

SH_COUNTS = (1, 4, 9, 16)
"""Spherical-harmonic coefficients per channel at degree 0, 1, 2, 3."""

SH0 = 0.28209479177387814
"""The constant harmonic, 1 / (2 sqrt(pi)): colour = 0.5 + SH0 * sh[:, 0] + ..."""

MOST = 12_000_000
"""Gaussians of one file: large scenes have 6 million, and each takes 500 bytes while it is read."""

F32 = NDArray[np.float32]

ARRAYS = ("means", "log_scales", "quats", "opacity_logits", "sh")
"""Attributes of `Gaussians` with an entry for each."""

_LEAST_OPACITY = 1e-4


@dataclass(frozen=True, kw_only=True)
class Gaussians:
    """N Gaussians in one frame; lengths in the unit of that frame.

    Attributes:
        means: (N, 3) float32 centres.
        log_scales: (N, 3) float32, natural logarithm of the standard deviations along own axes.
        quats: (N, 4) float32 w x y z, own axes to frame; any non-zero length.
        opacity_logits: (N,) float32; opacity = 1 / (1 + exp(-logit)), 1 of +inf. As a log scale of
            -inf is a size of 0, this is what converters write of full opacity and of flat ones.
        sh: (N, K, 3) float32, K in 1, 4, 9, 16; coefficients in the order and signs of 3DGS.
            Colour seen along unit direction d = max(0, 0.5 + sum_k Y_k(d) sh[:, k]).
        rasterize_mode: what they were trained for, by the file's own mark; None where there is
            none: such are drawn antialiased.
        projection: how they became pixels in training, as above; a suite says how it draws them.
        notes: what of their file was not read, and what is doubtful in it, for people.
    """

    means: F32
    log_scales: F32
    quats: F32
    opacity_logits: F32
    sh: F32
    rasterize_mode: RasterizeMode | None = None
    projection: Projection | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Make arrays contiguous float32 and check shapes.

        Raises:
            SceneError: when shapes do not agree or K is not 1, 4, 9 or 16.
        """
        for name in ARRAYS:
            array = np.ascontiguousarray(getattr(self, name), dtype=np.float32)
            object.__setattr__(self, name, array)
        n = len(self.means)
        expected = {
            "means": (n, 3),
            "log_scales": (n, 3),
            "quats": (n, 4),
            "opacity_logits": (n,),
            "sh": (n, self.sh.shape[1] if self.sh.ndim == 3 else -1, 3),
        }
        for name, shape in expected.items():
            if getattr(self, name).shape != shape:
                raise SceneError(
                    f"Gaussians.{name} has shape {getattr(self, name).shape}",
                    fix=f"give {shape} for {n} means",
                )
        if self.sh.shape[1] not in SH_COUNTS:
            raise SceneError(
                f"Gaussians.sh has {self.sh.shape[1]} coefficients per channel",
                fix="give 1, 4, 9 or 16 (degree 0 to 3)",
            )

    def __len__(self) -> int:
        return len(self.means)

    @property
    def sh_degree(self) -> int:
        """Degree of the harmonics, 0 to 3."""
        return SH_COUNTS.index(self.sh.shape[1])

    def take(self, selection: NDArray[np.bool_] | NDArray[np.integer] | slice) -> Gaussians:
        """Return the Gaussians at a mask, an index array or a slice."""
        return self._map(lambda array: array[selection])

    def _map(self, change: Callable[[F32], F32]) -> Gaussians:
        return replace(self, **{name: change(getattr(self, name)) for name in ARRAYS})


def drawable(gaussians: Gaussians) -> NDArray[np.bool_]:
    """Return which Gaussians (N,) can be drawn: the others are left out wherever they are used.

    Not drawn are centres, sizes (squared, in single precision), colours or rotations that are not
    finite, rotations of length 0, and opacities that are not a number.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        scales = same_bits.exp(gaussians.log_scales)
        return (
            np.isfinite(gaussians.means).all(axis=1)
            & np.isfinite(scales * scales).all(axis=1)
            & np.isfinite(gaussians.quats).all(axis=1)
            & (np.abs(gaussians.quats).max(axis=1, initial=0.0) > 0)
            & np.isfinite(gaussians.sh).all(axis=(1, 2))
            & ~np.isnan(gaussians.opacity_logits)
        )


def check_count(origin: object, count: int) -> None:
    """Check how many Gaussians a file claims to hold, before room is made for them.

    Raises:
        SceneError: more than `MOST`.
    """
    if count > MOST:
        raise SceneError(f"{origin}: {count} Gaussians", fix=f"{MOST} are read: prune it")


def concatenate(*parts: Gaussians) -> Gaussians:
    """Join sets; harmonics of lower degree are padded with zeros to the highest degree.

    Of sets with different marks the first one's count.
    """
    if not parts:
        raise SceneError("no Gaussians to concatenate", fix="give at least one set")
    most = max(part.sh.shape[1] for part in parts)
    sh = [np.pad(part.sh, ((0, 0), (0, most - part.sh.shape[1]), (0, 0))) for part in parts]
    return replace(
        parts[0],
        means=np.concatenate([part.means for part in parts]),
        log_scales=np.concatenate([part.log_scales for part in parts]),
        quats=np.concatenate([part.quats for part in parts]),
        opacity_logits=np.concatenate([part.opacity_logits for part in parts]),
        sh=np.concatenate(sh),
        notes=tuple(dict.fromkeys(note for part in parts for note in part.notes)),
    )


@dataclass(frozen=True, kw_only=True)
class SplatFigures:
    """Figures of a set of Gaussians.

    Attributes:
        count: all of them.
        visible: those that are drawn: with opacity of at least 1/255, and not of the next.
        not_finite: those that cannot be drawn, see `drawable`; they are left out everywhere.
        sh_degree: degree of the harmonics, 0 to 3.
        rasterize_mode: what the file says that they were trained for; None: nothing.
        projection: as above, how they became pixels in training.
        bounds: (low, high) corners of all finite centres, x y z each.
        bulk: the same for the middle 98 % along each axis: floaters left out.
        scale_percentiles: 1, 50 and 99 % of the largest standard deviation, in file units.
        opacity_histogram: how many have opacity in each tenth of 0..1.
        notes: as `Gaussians.notes`, and what is doubtful in these figures.
    """

    count: int
    visible: int
    not_finite: int
    sh_degree: int
    rasterize_mode: RasterizeMode | None
    projection: Projection | None
    bounds: tuple[tuple[float, ...], tuple[float, ...]]
    bulk: tuple[tuple[float, ...], tuple[float, ...]]
    scale_percentiles: tuple[float, float, float]
    opacity_histogram: tuple[int, ...]
    notes: tuple[str, ...] = ()


def describe(gaussians: Gaussians) -> SplatFigures:
    """Return the figures of a set of Gaussians."""
    finite = np.isfinite(gaussians.means).all(axis=1)
    centres = gaussians.means[finite]
    if len(centres) == 0:
        centres = np.zeros((1, 3), dtype=np.float32)
    finite = drawable(gaussians)
    opacity = sigmoid(gaussians.opacity_logits[finite])
    largest = same_bits.exp(
        np.clip(gaussians.log_scales[finite].max(axis=1, initial=-80.0), -80.0, 80.0)
    )
    percentiles = np.percentile(largest, [1, 50, 99]) if len(largest) else np.zeros(3)
    bulk = np.percentile(centres, [1, 99], axis=0)
    logits = gaussians.opacity_logits[finite]
    return SplatFigures(
        count=len(gaussians),
        visible=int((opacity >= 1.0 / 255.0).sum()),
        not_finite=int((~finite).sum()),
        sh_degree=gaussians.sh_degree,
        rasterize_mode=gaussians.rasterize_mode,
        projection=gaussians.projection,
        bounds=(_point(centres.min(axis=0)), _point(centres.max(axis=0))),
        bulk=(_point(bulk[0]), _point(bulk[1])),
        scale_percentiles=(float(percentiles[0]), float(percentiles[1]), float(percentiles[2])),
        opacity_histogram=tuple(np.histogram(opacity, bins=10, range=(0.0, 1.0))[0].tolist()),
        notes=(
            *gaussians.notes,
            *_doubts(float(np.ptp(bulk, axis=0).max()), float(percentiles[1]), centres, logits),
        ),
    )


_LARGE, _FEW = 0.1, 50
"""Size of the median Gaussian as a share of the whole, from which on it is doubted; of so many."""


def _doubts(width: float, size: float, centres: F32, logits: F32) -> list[str]:
    """Return what speaks against a file's numbers being what its format says."""
    doubts: list[str] = []
    kept = float(np.spacing(np.abs(centres).max()))
    if size > 0.0 and kept > size:
        doubts.append(
            f"centres are known to {kept:.2g} only, so far are they from the origin; the median "
            f"size is {size:.2g}: subtract their middle before they are written as float32"
        )
    if len(logits) >= _FEW and size > _LARGE * width:
        doubts.append(
            f"the median size is {size / width:.0%} of the whole: are scales natural logarithms?"
        )
    if len(logits) >= _FEW and logits.min() >= 0.0 and 0.0 < logits.max() <= 1.0:
        doubts.append("all stored opacities are from 0 to 1: are they logits?")
    return doubts


def _point(values: np.ndarray) -> tuple[float, ...]:
    return tuple(float(v) for v in values)


def logit(opacity: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
    """Return log(p / (1 - p)), p kept 1e-4 away from 0 and 1 so that bytes 0 and 255 are finite."""
    p = np.clip(opacity.astype(np.float64), _LEAST_OPACITY, 1.0 - _LEAST_OPACITY)
    return same_bits.log(p / (1.0 - p)).astype(np.float32)


def sigmoid(logits: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return 1 / (1 + exp(-x)) without overflow warnings."""
    with np.errstate(over="ignore"):
        return 1.0 / (1.0 + same_bits.exp(-logits.astype(np.float64)))


def to_byte(values: NDArray[np.floating[Any]]) -> NDArray[np.uint8]:
    """Round to the nearest integer of 0..255; NaN becomes 0."""
    return np.clip(np.rint(np.nan_to_num(values)), 0, 255).astype(np.uint8)


def unit_quats(quats: NDArray[np.float32]) -> NDArray[np.float64]:
    """(n, 4) float64 of length 1; what has no length becomes the identity."""
    q = np.nan_to_num(quats.astype(np.float64))
    length = np.linalg.norm(q, axis=1, keepdims=True)
    return np.where(length > 0, q / np.maximum(length, 1e-30), [1.0, 0.0, 0.0, 0.0])


_FIRST = (0, 1, 4, 9)


def transformed(gaussians: Gaussians, T: NDArray[np.float64]) -> Gaussians:
    """Return the Gaussians mapped by a similarity: rotation, positive scale, translation.

    Args:
        gaussians: N Gaussians in frame a.
        T: (4, 4) T_b_a.

    Returns:
        The same Gaussians in frame b.

    Raises:
        SceneError: when T is no similarity.
    """
    linear = np.asarray(T, dtype=np.float64)[:3, :3]
    determinant = float(np.linalg.det(linear))
    scale = abs(determinant) ** (1 / 3)
    rotation = linear / max(scale, 1e-300)
    if determinant <= 0 or np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-4:
        raise SceneError(
            f"not a similarity: determinant {determinant:g}", fix="give a rotation times a scale"
        )
    w, x, y, z = quaternions(rotation)
    left = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    return replace(
        gaussians,
        means=(gaussians.means @ linear.T + T[:3, 3]).astype(np.float32),
        log_scales=gaussians.log_scales + np.float32(math.log(scale)),
        quats=(gaussians.quats @ left.T).astype(np.float32),
        sh=rotate_harmonics(gaussians.sh, rotation),
    )


def rotate_harmonics(sh: NDArray[np.float32], rotation: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return the (N, K, 3) coefficients of functions turned by a rotation: f'(R d) = f(d).

    Within a degree the harmonics span a space that rotations map to itself, so its matrix follows
    from values at enough directions: Y(d) c' = Y(R' d) c for all d.
    """
    out = sh.copy()
    directions = np.random.default_rng(1).normal(size=(64, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    original, there = harmonics(directions), harmonics(directions @ rotation)
    for degree in (1, 2, 3):
        first = _FIRST[degree]
        part = slice(first, first + 2 * degree + 1)
        if first >= sh.shape[1]:
            break
        matrix = np.linalg.lstsq(original[:, part], there[:, part], rcond=None)[0]
        out[:, part] = np.einsum("ij,njc->nic", matrix.astype(np.float32), sh[:, part])
    return out


def harmonics(directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 16) values of the real harmonics of degree 0 to 3 in 3DGS order, at unit directions."""
    x, y, z = directions.T
    xx, yy, zz = x * x, y * y, z * z
    return np.stack(
        [
            np.full_like(x, 0.28209479177387814),
            -0.4886025119029199 * y,
            0.4886025119029199 * z,
            -0.4886025119029199 * x,
            1.0925484305920792 * x * y,
            -1.0925484305920792 * y * z,
            0.31539156525252005 * (2 * zz - xx - yy),
            -1.0925484305920792 * x * z,
            0.5462742152960396 * (xx - yy),
            -0.5900435899266435 * y * (3 * xx - yy),
            2.890611442640554 * x * y * z,
            -0.4570457994644658 * y * (4 * zz - xx - yy),
            0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy),
            -0.4570457994644658 * x * (4 * zz - xx - yy),
            1.445305721320277 * z * (xx - yy),
            -0.5900435899266435 * x * (xx - 3 * yy),
        ],
        axis=-1,
    )


def quaternions(rotations: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the w x y z (..., 4) of rotation matrices (..., 3, 3).

    The eigenvector of Davenport's matrix with the largest eigenvalue.
    """
    r = np.moveaxis(rotations, (-2, -1), (0, 1))
    rows = [
        [r[0, 0] + r[1, 1] + r[2, 2], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
        [r[2, 1] - r[1, 2], r[0, 0] - r[1, 1] - r[2, 2], r[1, 0] + r[0, 1], r[0, 2] + r[2, 0]],
        [r[0, 2] - r[2, 0], r[1, 0] + r[0, 1], r[1, 1] - r[0, 0] - r[2, 2], r[2, 1] + r[1, 2]],
        [r[1, 0] - r[0, 1], r[0, 2] + r[2, 0], r[2, 1] + r[1, 2], r[2, 2] - r[0, 0] - r[1, 1]],
    ]
    davenport = np.moveaxis(np.array(rows), (0, 1), (-2, -1))
    return np.linalg.eigh(davenport)[1][..., 3]
