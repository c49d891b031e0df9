"""Compiled Gaussians: their arrangement, and one file that every process that renders them maps.

Gaussians are ordered by size class, then along a Morton curve, and cut into chunks of 256. Large
ones get chunks of their own, so that they do not widen the bounds that culling works with. A
chunk is 16 groups of sixteen; in a group each value stands sixteen times in a row, so that it loads
as one vector and a chunk reads as one stream. Harmonics above the constant are float16: 142 bytes
per Gaussian at degree 3.

The file (`.nwsplat`): a first line of JSON (format, kernel layout, counts, where each array lies),
padded to a multiple of 64 bytes, then the arrays, each at a multiple of 64, then the seal of
`files.cache`. A file that is damaged, cut short, of another layout or of another content does not
open.

The format is private and changes with versions. It has covariances in place of scales and
rotations, and lacks what no camera sees; what is read back as Gaussians renders as the file does.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_base import same_bits
from nw_base.errors import SceneError
from nw_base.files.cache import DamagedError, read_sealed, sealed_path
from nw_base.words import PROJECTIONS, RASTERIZE_MODES, Projection, RasterizeMode
from nw_splat.gaussians import SH0, SH_COUNTS, Gaussians, drawable, quaternions

FORMAT = 5
"""Changes with the layout of the arrays; part of every cache key."""

SUFFIX = ".nwsplat"
"""Of our own: `.splat` is another format, which anybody reads."""

_MAGIC = "nw-eval splat store"
MARK = f'{{"magic": "{_MAGIC}"'.encode()
"""What a file begins with."""

_REBUILD = "delete it; it is rebuilt on the next use"
_ALIGN = 64
_HEADER_LIMIT = 4096
_ARRAYS = {"geometry": "<f4", "dc": "<f4", "sh": "<u2", "bounds": "<f4"}

CHUNK = 256
GROUP = 16
GEOMETRY = 10
BOUNDS = 8
_HALF_MAX = 65504.0
_INVISIBLE = -200.0
_BLOCK = 1 << 16

_THINNEST = 1e-8  # of the largest variance, which is what float32 knows.
_OPAQUE = 1.0 - 2.0**-24


@dataclass(frozen=True, kw_only=True)
class Store:
    """Gaussians arranged for the kernels; see `Layout` for the arrays.

    Attributes:
        count: Gaussians that can be seen.
        sh_count: harmonics per channel: 1, 4, 9 or 16.
        layout: the arrays, read-only.
        path: the file behind them; None when they live in memory.
        key: identity of the compiled splat, as given to `compile_store`.
        rasterize_mode: see `Gaussians`; None is drawn antialiased.
        projection, notes: see `Gaussians`.
    """

    count: int
    sh_count: int
    layout: Layout
    path: Path | None
    key: str
    rasterize_mode: RasterizeMode | None = None
    projection: Projection | None = None
    notes: tuple[str, ...] = ()

    @property
    def chunks(self) -> int:
        """Number of chunks."""
        return self.layout.chunks

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        return sum(array.nbytes for array in self.layout.arrays().values())


def memory_store(gaussians: Gaussians) -> Store:
    """Compile Gaussians without a file, for tests and one-off pictures."""
    layout = arrange(gaussians)
    return Store(
        count=layout.count,
        sh_count=gaussians.sh.shape[1],
        layout=layout,
        path=None,
        key="",
        rasterize_mode=gaussians.rasterize_mode,
        projection=gaussians.projection,
        notes=gaussians.notes,
    )


def compile_store(gaussians: Gaussians, path: Path, *, key: str = "") -> None:
    """Compile Gaussians to a file, which appears whole or not at all.

    Args:
        gaussians: what to compile; those that can never be seen are left out.
        path: the file to write; its folder is made.
        key: identifies the content; `open_store` can insist on it.

    Raises:
        SceneError: when no Gaussian could ever be seen.
        StoreError: when the file cannot be written.
    """
    store = memory_store(gaussians)
    places: dict[str, tuple[int, int]] = {}
    offset = _HEADER_LIMIT
    arrays = store.layout.arrays()
    for name, array in arrays.items():
        places[name] = (offset, array.size)
        offset += -(-array.nbytes // _ALIGN) * _ALIGN
    header = {
        "magic": _MAGIC,
        "format": FORMAT,
        "key": key,
        "count": store.count,
        "sh_count": store.sh_count,
        "chunks": store.chunks,
        "arrays": places,
        "rasterize_mode": store.rasterize_mode,
        "projection": store.projection,
        "notes": _fitting(store.notes),
    }
    with sealed_path(path) as temporary, temporary.open("wb") as file:
        file.write(json.dumps(header).encode().ljust(_HEADER_LIMIT - 1) + b"\n")
        for name, array in arrays.items():
            file.seek(places[name][0])
            file.write(array.data)


def _fitting(notes: tuple[str, ...]) -> list[str]:
    """Return the first notes, as many as the header has room for."""
    sizes = np.cumsum([len(json.dumps(note)) + 2 for note in notes])
    return list(notes[: int((sizes < _HEADER_LIMIT // 2).sum())])


def open_store(path: Path, *, key: str | None = None) -> Store:
    """Map a compiled store read-only; its content is checked, which takes 10 ms a scene.

    Args:
        path: a file written by `compile_store`.
        key: the key that it must carry; None accepts any.

    Raises:
        SceneError: when the file is missing, damaged, of another layout or of another content.
    """
    try:
        mapped = read_sealed(path)
    except OSError as error:
        raise SceneError(f"{path}: {error.strerror or error}", fix=_REBUILD) from error
    except DamagedError as error:
        raise SceneError(f"{path}: {error}", fix=_REBUILD) from error
    header = _read_header(bytes(mapped[:_HEADER_LIMIT]), path)
    if key is not None and header["key"] != key:
        raise SceneError(f"{path}: holds {header['key']!r}, not {key!r}", fix=_REBUILD)
    try:
        arrays = {
            name: np.frombuffer(
                mapped,
                dtype=kind,
                offset=header["arrays"][name][0],
                count=header["arrays"][name][1],
            )
            for name, kind in _ARRAYS.items()
        }
        layout = Layout(count=header["count"], sh_count=header["sh_count"], **arrays)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise SceneError(
            f"{path}: its header does not describe it ({error})", fix=_REBUILD
        ) from error
    if not np.isfinite(layout.bounds).all():
        raise SceneError(f"{path}: its bounds are damaged", fix=_REBUILD)
    return Store(
        count=layout.count,
        sh_count=layout.sh_count,
        layout=layout,
        path=path,
        key=header["key"],
        rasterize_mode=header.get("rasterize_mode"),
        projection=header.get("projection"),
        notes=tuple(map(str, header.get("notes", ()))),
    )


def _read_header(raw: bytes, path: Path) -> dict[str, Any]:
    try:
        header: Any = json.loads(raw)
    except ValueError as error:
        raise SceneError(f"{path}: no compiled splat store", fix=_REBUILD) from error
    if not isinstance(header, dict) or header.get("magic") != _MAGIC:
        raise SceneError(f"{path}: no compiled splat store", fix=_REBUILD)
    if header.get("format") != FORMAT:
        raise SceneError(
            f"{path}: store format {header.get('format')}, this version reads {FORMAT}",
            fix=_REBUILD,
        )
    if not all(isinstance(header.get(k), int) for k in ("count", "sh_count")):
        raise SceneError(f"{path}: its header is incomplete", fix=_REBUILD)
    modes, projections = (None, *RASTERIZE_MODES), (None, *PROJECTIONS)
    if not (header.get("rasterize_mode") in modes and header.get("projection") in projections):
        raise SceneError(f"{path}: its header names no way to draw it", fix=_REBUILD)
    return header


def digest(gaussians: Gaussians) -> str:
    """Return the hex sha256 of the content of a set of Gaussians."""
    total = hashlib.sha256()
    for name in ("means", "log_scales", "quats", "opacity_logits", "sh"):
        array = getattr(gaussians, name)
        total.update(f"{name}{array.shape}".encode())
        total.update(array.data)
    if gaussians.rasterize_mode is not None:
        total.update(gaussians.rasterize_mode.encode())
    if gaussians.projection is not None:
        total.update(gaussians.projection.encode())
    return total.hexdigest()


def read_compiled(path: Path) -> Gaussians:
    """Read a compiled splat.

    Raises:
        SceneError: it is damaged, or another version wrote it.
    """
    store = open_store(path)
    held = unpack(store.layout)
    # A seal shows damage, not tampering.
    whole = np.isfinite(held.covariances).all(axis=(1, 2)) & np.isfinite(held.opacities)
    variances, axes = np.linalg.eigh(held.covariances[whole].astype(np.float64))
    axes[np.linalg.det(axes) < 0, :, 0] *= -1.0  # A reflection is no rotation.
    variances = np.maximum(variances, np.maximum(variances[:, 2:] * _THINNEST, 1e-38))
    opacities = np.clip(held.opacities[whole].astype(np.float64), 1e-38, _OPAQUE)
    return Gaussians(
        means=held.means[whole],
        log_scales=(0.5 * same_bits.log(variances)).astype(np.float32),
        quats=quaternions(axes).astype(np.float32),
        opacity_logits=same_bits.log(opacities / (1.0 - opacities)).astype(np.float32),
        sh=held.sh[whole],
        rasterize_mode=store.rasterize_mode,
        projection=store.projection,
    )


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


def arrange(gaussians: Gaussians) -> Layout:
    """Compute what does not depend on the camera and order the Gaussians for culling.

    Gaussians with opacity below 1/255 or values that are not finite are left out: no camera sees
    them.

    Raises:
        SceneError: when none is left.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        opacity = 1.0 / (1.0 + same_bits.exp(-gaussians.opacity_logits.astype(np.float64)))
        scales = same_bits.exp(gaussians.log_scales)
    kept = np.flatnonzero(drawable(gaussians) & (opacity >= 1.0 / 255.0))
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
        values[:, 9] = same_bits.log2(opacity[rows])
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
    """Return the Gaussians of a layout, in its order and to its precision."""
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
    level = np.floor(same_bits.log2(np.maximum(ratio, 1.0)))
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
