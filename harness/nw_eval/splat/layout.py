"""The arrangement of Gaussians that the kernels read.

Gaussians are ordered by size class, then along a Morton curve, and cut into chunks of 256. Large
ones get chunks of their own, so that they do not widen the bounds that culling works with. A
chunk is 16 groups of sixteen; in a group each value stands sixteen times in a row, so that it loads
as one vector and a chunk reads as one stream. Harmonics above the constant are float16: 142 bytes
per Gaussian at degree 3.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import SceneError
from nw_eval.splat.gaussians import SH0, SH_COUNTS, Gaussians

CHUNK = 256
GROUP = 16
GEOMETRY = 10
BOUNDS = 8
_HALF_MAX = 65504.0
_INVISIBLE = -200.0
_BLOCK = 1 << 16


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Flat arrays, group by group, value by value, sixteen Gaussians each.

    Attributes:
        count: Gaussians; the last chunk is padded with invisible ones.
        sh_count: harmonics per channel: 1, 4, 9 or 16.
        geometry: float32 centre x y z, covariance xx xy xz yy yz zz, log2 opacity.
        dc: float32 r g b of 0.5 + constant harmonic.
        sh: float16 bits of the other harmonics: channel by channel, coefficient by coefficient.
        bounds: float32 per chunk: box centre (3), half extent (3), largest standard deviation, 0.
    """

    count: int
    sh_count: int
    geometry: NDArray[np.float32]
    dc: NDArray[np.float32]
    sh: NDArray[np.uint16]
    bounds: NDArray[np.float32]

    def __post_init__(self) -> None:
        """Check that the arrays have the sizes that the kernels take for granted."""
        if self.sh_count not in SH_COUNTS:
            raise ValueError(f"sh_count {self.sh_count}")
        n = self.chunks * CHUNK
        sizes = (len(self.geometry), len(self.dc), len(self.sh), len(self.bounds))
        expected = (
            n * GEOMETRY,
            n * 3,
            max(n * 3 * (self.sh_count - 1), 8),
            self.chunks * BOUNDS,
        )
        if sizes != expected:
            raise ValueError(f"array sizes {sizes}, {self.count} Gaussians need {expected}")
        # Read-only in memory as in a mapped file: kernels are compiled for one kind of array.
        for array in (self.geometry, self.dc, self.sh, self.bounds):
            array.flags.writeable = False

    @property
    def chunks(self) -> int:
        """Number of chunks."""
        return -(-self.count // CHUNK)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays by name, in the order of a store file."""
        return {name: getattr(self, name) for name in ("geometry", "dc", "sh", "bounds")}


@dataclass(frozen=True, kw_only=True)
class Unpacked:
    """A layout's Gaussians one by one, as other renderers take them.

    Attributes:
        means: (N, 3) float32.
        covariances: (N, 3, 3) float32.
        opacities: (N,) float32, 0 to 1.
        sh: (N, K, 3) float32.
    """

    means: NDArray[np.float32]
    covariances: NDArray[np.float32]
    opacities: NDArray[np.float32]
    sh: NDArray[np.float32]


def unpack(layout: Layout) -> Unpacked:
    """Return what a layout holds, in its order and to its precision."""
    n, rest = layout.count, layout.sh_count - 1

    def rows(values: NDArray[Any], width: int) -> NDArray[np.float32]:
        groups = values.reshape(-1, width, GROUP).transpose(0, 2, 1)
        return groups.reshape(-1, width)[:n].astype(np.float32)

    geometry = rows(layout.geometry, GEOMETRY)
    sh = (rows(layout.dc, 3)[:, None] - np.float32(0.5)) / np.float32(SH0)
    if rest:
        others = rows(layout.sh.view(np.float16), 3 * rest).reshape(n, 3, rest)
        sh = np.concatenate([sh, others.transpose(0, 2, 1)], axis=1)
    return Unpacked(
        means=geometry[:, :3],
        covariances=geometry[:, [3, 4, 5, 4, 6, 7, 5, 7, 8]].reshape(n, 3, 3),
        opacities=np.exp2(geometry[:, 9]),
        sh=sh,
    )


def arrange(gaussians: Gaussians) -> Layout:
    """Compute what does not depend on the camera and order the Gaussians for culling.

    Gaussians with opacity below 1/255 or values that are not finite are left out: no camera sees
    them.

    Raises:
        SceneError: when none is left.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        opacity = 1.0 / (1.0 + np.exp(-gaussians.opacity_logits.astype(np.float64)))
        scales = np.exp(gaussians.log_scales)
        finite = (
            np.isfinite(gaussians.means).all(axis=1)
            & np.isfinite(scales * scales).all(axis=1)
            & np.isfinite(gaussians.quats).all(axis=1)
            & (np.abs(gaussians.quats).max(axis=1, initial=0.0) > 0)
            & np.isfinite(gaussians.sh).all(axis=(1, 2))
        )
    kept = np.flatnonzero(finite & (opacity >= 1.0 / 255.0))
    if len(kept) == 0:
        raise SceneError(
            f"none of {len(gaussians)} Gaussians can be seen",
            fix="check that opacities are logits and values are finite",
        )
    largest = scales.max(axis=1)
    order = kept[np.lexsort((_morton(gaussians.means[kept]), _size_class(largest[kept])))]
    count = len(order)
    chunks = -(-count // CHUNK)
    sh_count = gaussians.sh.shape[1]
    groups = chunks * (CHUNK // GROUP)
    geometry = np.zeros((groups, GEOMETRY, GROUP), dtype=np.float32)
    dc = np.zeros((groups, 3, GROUP), dtype=np.float32)
    sh = np.zeros((groups, 3 * (sh_count - 1), GROUP), dtype=np.float16)
    bounds = np.zeros((chunks, BOUNDS), dtype=np.float32)
    values = np.empty((0, GEOMETRY), dtype=np.float32)
    # By blocks of whole chunks, so that temporaries stay small beside the result.
    for start in range(0, count, _BLOCK):
        rows = order[start : start + _BLOCK]
        part = slice(start // GROUP, start // GROUP - (-len(rows) // GROUP))
        values = np.empty((len(rows), GEOMETRY), dtype=np.float32)
        values[:, :3] = gaussians.means[rows]
        values[:, 3:9] = _covariances(gaussians.quats[rows], scales[rows])
        values[:, 9] = np.log2(opacity[rows])
        _fill(geometry[part], values)
        _fill(dc[part], gaussians.sh[rows, 0] * np.float32(SH0) + np.float32(0.5))
        if sh_count > 1:
            rest = np.clip(gaussians.sh[rows, 1:], -_HALF_MAX, _HALF_MAX)
            _fill(sh[part], rest.transpose(0, 2, 1).reshape(len(rows), -1))
        bounds[start // CHUNK : start // CHUNK - (-len(rows) // CHUNK)] = _bounds(
            values[:, :3], largest[rows]
        )
    # Padding sits on the last Gaussian, inside its chunk's box, and is invisible.
    padding = np.append(values[-1, :-1], np.float32(_INVISIBLE))
    if count % GROUP:
        geometry[count // GROUP, :, count % GROUP :] = padding[:, None]
    geometry[-(-count // GROUP) :] = padding[:, None]
    return Layout(
        count=count,
        sh_count=sh_count,
        geometry=geometry.reshape(-1),
        dc=dc.reshape(-1),
        sh=sh.view(np.uint16).reshape(-1) if sh_count > 1 else np.zeros(8, dtype=np.uint16),
        bounds=bounds.reshape(-1),
    )


def _fill(target: NDArray[Any], values: NDArray[np.float32]) -> None:
    """Write (n, values) into (groups, values, 16)."""
    whole, rest = divmod(len(values), GROUP)
    split = whole * GROUP
    width = values.shape[1]
    target[:whole] = values[:split].reshape(whole, GROUP, width).transpose(0, 2, 1)
    if rest:
        target[whole, :, :rest] = values[split:].T


def _covariances(quats: NDArray[np.float32], scales: NDArray[np.float32]) -> NDArray[np.float64]:
    """(n, 6) float64 xx xy xz yy yz zz of R diag(s)^2 R'."""
    q = quats.astype(np.float64)
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    w, x, y, z = q.T
    rotation = np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], axis=-1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], axis=-1),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=-1),
        ],
        axis=1,
    )
    half = rotation * scales[:, None, :]
    rows = (0, 0, 0, 1, 1, 2)
    columns = (0, 1, 2, 1, 2, 2)
    return np.stack(
        [(half[:, i] * half[:, j]).sum(axis=1) for i, j in zip(rows, columns, strict=True)], axis=-1
    )


def _bounds(means: NDArray[np.float32], largest: NDArray[np.float32]) -> NDArray[np.float32]:
    """(chunks, BOUNDS) of consecutive groups of 256; boxes a little wide against rounding."""
    starts = np.arange(0, len(means), CHUNK)
    low = np.minimum.reduceat(means, starts).astype(np.float64)
    high = np.maximum.reduceat(means, starts).astype(np.float64)
    centre = (low + high) / 2
    half = (high - low) / 2 * 1.0001 + 1e-6 * (1.0 + np.abs(centre))
    size = np.maximum.reduceat(largest, starts)[:, None]
    return np.concatenate([centre, half, size, np.zeros_like(size)], axis=1).astype(np.float32)


def _size_class(largest: NDArray[np.float32]) -> NDArray[np.int64]:
    """0 up to four times the median size, then one class for each doubling."""
    ratio = largest / max(float(np.median(largest)), 1e-30)
    level = np.floor(np.log2(np.maximum(ratio, 1.0)))
    return np.where(level <= 1, 0, np.minimum(level, 8)).astype(np.int64)


def _morton(points: NDArray[np.float32]) -> NDArray[np.uint64]:
    """(n,) position along a Morton curve of 2^10 cells a side over the bulk of the points."""
    low, high = np.percentile(points, [1, 99], axis=0)
    margin = (high - low) * 0.5
    low, high = low - margin, high + margin
    cells = np.clip((points - low) / np.maximum(high - low, 1e-9), 0.0, 1.0) * 1023.0
    code = np.zeros(len(points), dtype=np.uint64)
    for axis in range(3):
        v = cells[:, axis].astype(np.uint64)
        # Spread ten bits to every third place.
        for shift, mask in ((16, 0x30000FF), (8, 0x300F00F), (4, 0x30C30C3), (2, 0x9249249)):
            v = (v | (v << np.uint64(shift))) & np.uint64(mask)
        code |= v << np.uint64(axis)
    return code
