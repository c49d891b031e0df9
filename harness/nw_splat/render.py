"""Renderers: a store and a camera in, an image out.

Through a lens, a Gaussian's response depends on a pixel only by the point where the pixel's ray
meets the picture of a pinhole at the same place (kernels/project.py). So records are made for that
pinhole, and blended at those points: two loads more for a block of pixels. What else changes:

* A box of the pinhole's picture becomes one of pixels by tables (`first`, `last`): which is the
  first column that has a point so far to the right, and which the last that has one so far left.
* The low-pass is as wide as a pixel is where the Gaussian lies. With r the slope from the axis and
  r' that on the image, a pixel is t = r / r' wide across the radius and dr / dr' along it; the
  variance is eps2d (t^2 I + d s s') with the slopes s and d = ((dr / dr')^2 - t^2) / r^2. Both are
  polynomials in w = r^2 / (1 + r^2), times 1 + r^2. The tangential part of a lens (p1, p2) is left
  out of the low-pass, not of the points.
"""

from __future__ import annotations

import math
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import UsageError, nearest
from nw_base.lens import Intrinsics
from nw_base.words import PROJECTIONS, Backend, Projection
from nw_splat.camera import (
    MAX_SIDE,
    Camera,
    Pixels,
    PresetName,
    Rows,
    Window,
    get_preset,
    view_vector,
)
from nw_splat.image import Image
from nw_splat.kernels import draw as frame
from nw_splat.kernels import insert
from nw_splat.kernels.blend import CHANNELS, CURVE, PIXELS, SLACK_COLUMNS, SLACK_ROWS
from nw_splat.kernels.draw import HISTOGRAM
from nw_splat.kernels.project import RECORD
from nw_splat.store import CHUNK, GROUP, Store

_DEGREE = 4  # of the polynomials
_ROOM = MAX_SIDE - 4


@dataclass(frozen=True, eq=False, kw_only=True)
class LensMap:
    """One window of the pixels of a lens.

    Attributes:
        pinhole: its width, height, fx, fy, cx, cy in pixels of the pinhole's picture.
        columns: (rows * stride,) float32, x of the pixels' points in that picture.
        rows: as above, y.
        tables: first and last column, first and last row, of each of its columns and rows.
        blur: t^2's coefficients, d's, the largest w, and the largest variance: 2 * 5 + 2.
        place: column, row, width and height of the window.
    """

    pinhole: tuple[int, int, float, float, float, float]
    columns: NDArray[np.float32]
    rows: NDArray[np.float32]
    tables: tuple[NDArray[np.int64], ...]
    blur: NDArray[np.float32]
    place: NDArray[np.int64]

    def camera(self, seen: Camera, near: float) -> Camera:
        """Return the pinhole where a camera is."""
        width, height, fx, fy, cx, cy = self.pinhole
        return Camera(
            width=width,
            height=height,
            fx=fx,
            fy=fy,
            cx=cx,
            cy=cy,
            T_world_camera=seen.T_world_camera,
            near=near,
            far=seen.far,
        )


@lru_cache(maxsize=128)
def lens_map(lens: Intrinsics, pixels: Pixels, window: Window, samples: int) -> LensMap:
    """Return the map of a window.

    Args:
        lens: of the image.
        pixels: of its samples.
        window: of the pixel set.
        samples: along each side of a pixel.
    """
    column0, column1, row0, row1 = window
    x = np.array([pixels.index(i) + 0.5 for i in range(column0, column1)]) / samples
    y = np.array([pixels.index(i) + 0.5 for i in range(row0, row1)]) / samples
    slopes = lens.grid(x, y)
    fx, fy = samples * lens.fx, samples * lens.fy
    spans = np.ptp(slopes, axis=(0, 1)) * (fx, fy)
    scale = min(1.0, _ROOM / float(spans.max()))
    points = slopes * (scale * fx, scale * fy)
    low, high = points.min(axis=(0, 1)), points.max(axis=(0, 1))
    points = points - low + 1.0
    width, height = (int(side) + 3 for side in high - low)
    cx, cy = (1.0 - low).tolist()
    return LensMap(
        pinhole=(width, height, scale * fx, scale * fy, cx, cy),
        columns=_laid(points[..., 0]),
        rows=_laid(points[..., 1]),
        tables=(*_tables(points[..., 0], width), *_tables(points[..., 1].T, height)),
        blur=_blur(lens, scale),
        place=np.array([column0, row0, column1 - column0, row1 - row0]),
    )


def _laid(values: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return values (H, W) as the framebuffer has its pixels, with the slack of vectors."""
    return np.pad(values, ((0, SLACK_ROWS), (0, SLACK_COLUMNS))).astype(np.float32).reshape(-1)


def _tables(values: NDArray[np.float64], count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first and the last column of values (rows, columns) for each whole number."""
    most = np.maximum.accumulate(values.max(axis=0))
    least = np.minimum.accumulate(values.min(axis=0)[::-1])[::-1]
    edges = np.arange(count, dtype=np.float64)
    # A point that float32 rounds over an edge belongs to both sides.
    first = np.searchsorted(most, edges - 0.01)
    last = np.searchsorted(least, edges + 1.01, side="right") - 1
    return first.astype(np.int64), last.astype(np.int64)


def _blur(lens: Intrinsics, scale: float) -> NDArray[np.float32]:
    assert lens.distortion is not None, "a pinhole has no map"
    corners = [((x - lens.cx) / lens.fx, (y - lens.cy) / lens.fy)
               for x in (0.0, lens.width) for y in (0.0, lens.height)]  # fmt: skip
    widest = max(math.hypot(*corner) for corner in corners)
    seen = np.linspace(0.0, widest, 200)[1:]
    radial = lens.distortion
    if radial.model == "radial_tangential":
        k1, k2, _, _, *others = radial.coefficients
        radial = radial.model_copy(update={"coefficients": (k1, k2, 0.0, 0.0, *others)})
    r = radial.straight(np.stack([seen, np.zeros_like(seen)], axis=-1))[:, 0]
    there = np.isfinite(r)
    seen, r = seen[there], r[there]
    across = (r / seen) ** 2
    along = np.gradient(r, seen, edge_order=2) ** 2
    w = r * r / (1.0 + r * r)
    fits = [
        np.polynomial.polynomial.polyfit(w, values * (1.0 - w), _DEGREE)
        for values in (across, (along - across) / (r * r))
    ]
    most = 2.0 * max(float(across.max()), float(along.max()))
    k = scale * scale
    return np.array([*(k * fits[0]), *(k * fits[1]), w[-1], k * most], dtype=np.float32)


_SLAB_CHUNKS = 128
"""Chunks of a slab: about 33,000 Gaussians, whose records fit the caches near the core."""


SAMPLED_EPS2D = 0.05
"""Variance added to footprints with four samples a pixel, in samples squared.

Less gains nothing against truth in built-in scenes, and more blurs (tests/bench/bench_truth.py).
"""


class Renderer(Protocol):
    """Renders one store; belongs to one thread."""

    def render(self, camera: Camera, pixels: Pixels = ..., rows: Rows | None = None) -> Image:
        """Return the image of a camera, or a pixel set of it, or some rows of that."""
        ...


@dataclass(frozen=True, kw_only=True)
class Stages:
    """Thread CPU time of one frame in seconds, and counts of its Gaussians and pixels.

    `cull` includes clearing, `project` harmonics, `blend` the output arrays.
    """

    cull: float
    project: float
    sort: float
    blend: float
    visible_chunks: int
    hidden_chunks: int
    records: int
    vectors: int
    drawn: int

    @property
    def total(self) -> float:
        """Seconds of all stages."""
        return self.cull + self.project + self.sort + self.blend


class CpuRenderer:
    """The compiled renderer.

    Semantics are gsplat's: exact depth order by centres, alpha clamp and threshold, early
    termination, expected depth; with `ewa` its projection with clamped Jacobian, too. `ray` takes
    the greatest response of a Gaussian along the pixel's own ray instead (kernels/project.py has
    the closed form), and draws no Gaussian whose centre lies beyond 88 degrees from the axis. Both
    are one where Gaussians are small against their distance. The bits of a pixel do not depend on
    the threads or the pixel set that it is rendered with. A camera with distortion is always drawn
    along the ray, each pixel at its own.

    With one sample a pixel, every footprint is widened by the preset's low-pass (.3 pixels
    squared), and antialiased mode takes from the opacity what the blur added. With four, each pixel
    is the mean of 2x2 samples, each a smaller pixel; that is what keeps the picture from aliasing.
    The low-pass is then only as wide as float32 needs for flat Gaussians seen from the side
    (`SAMPLED_EPS2D`), and what it adds is taken from the opacity in both modes.

    Args:
        store: what to render; shared between renderers and processes.
        preset: which gsplat's numerical choices.
        antialiased: compensate opacity for the blur of small splats; None: unless the store is
            marked classic. With four samples it always is.
        projection: "ewa" as gsplat and the published protocol have it, or "ray".
        samples: of a pixel, 1 or 4.
        near: least depth of a Gaussian's centre in camera units; None: the camera's near plane.
        background: colour behind everything.
        threads: split a frame into this many windows side by side, one thread each.
    """

    def __init__(
        self,
        store: Store,
        *,
        preset: PresetName = "gsplat-1.5",
        antialiased: bool | None = None,
        projection: Projection = "ewa",
        samples: int = 1,
        near: float | None = None,
        background: tuple[float, float, float] = (1.0, 1.0, 1.0),
        threads: int = 1,
    ) -> None:
        if threads < 1:
            raise UsageError(f"threads is {threads}", fix="give 1 or more")
        if len(background) != 3 or not all(map(math.isfinite, background)):
            raise UsageError(f"background is {background}", fix="give three finite numbers")
        if projection not in PROJECTIONS:
            raise UsageError(
                f"unknown projection {projection!r}", fix=nearest(projection, PROJECTIONS)
            )
        if samples not in (1, 4):
            raise UsageError(f"samples is {samples}", fix="give 1 or 4 samples a pixel")
        if near is not None and not 0.0 < near < math.inf:
            raise UsageError(f"near is {near}", fix="give a positive depth")
        self.store = store
        self._preset = get_preset(preset)
        classic = store.rasterize_mode == "classic"
        self._antialiased = not classic if antialiased is None else antialiased
        self._ray = True if projection == "ray" else None
        self._side = 2 if samples == 4 else 1
        self._near = near
        self._background = np.asarray(background, dtype=np.float32)
        self._works = [_Workspace(store) for _ in range(threads)]
        self._pool = ThreadPoolExecutor(threads) if threads > 1 else None

    def render(
        self,
        camera: Camera,
        pixels: Pixels = Pixels(),  # noqa: B008 (frozen)
        rows: Rows | None = None,
    ) -> Image:
        """Return the image of a camera, or a pixel set of it; the caller owns the arrays.

        Args:
            camera: of the whole image.
            pixels: of it.
            rows: of the pixel set, which are all that is drawn and returned; None = all.

        Raises:
            UsageError: when the pixel set selects no pixel of the image.
        """
        return self._render(camera, pixels, rows, clock=-1)

    def surface(
        self,
        camera: Camera,
        pixels: Pixels = Pixels(),  # noqa: B008 (frozen)
        rows: Rows | None = None,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return depth (H, W) along the optical axis, where pixels meet the Gaussians, and alpha.

        Each Gaussian counts at the depth of its greatest response on the pixel's ray, to first
        order, as in RaDe-GS (Zhang et al., arXiv 2406.01467); here the order is of 1 / depth, which
        is exact for flat Gaussians and for centres. A pixel's 1 / depth is their mean, each weighed
        by what it adds to the picture, and 0, a depth of inf, where nothing does. Gaussians are
        taken along the ray, whatever the projection of pictures.

        Args:
            camera: of the whole image.
            pixels: of it.
            rows: as for `render`.
        """
        image = self._render(camera, pixels, rows, clock=-1, surface=True)
        inverse = np.maximum(image.depth, np.float32(0.0))
        with np.errstate(divide="ignore"):
            return (1.0 / inverse).astype(np.float32, copy=False), image.alpha

    def render_timed(self, camera: Camera, pixels: Pixels = Pixels()) -> tuple[Image, Stages]:  # noqa: B008
        """Render and tell what each stage cost, summed over threads."""
        image = self._render(camera, pixels, None, clock=time.CLOCK_THREAD_CPUTIME_ID)
        total = np.sum([work.statistics for work in self._works], axis=0)
        ns = 1e-9
        return image, Stages(
            cull=float(total[frame.CULL]) * ns,
            project=float(total[frame.PROJECT]) * ns,
            sort=float(total[frame.SORT]) * ns,
            blend=float(total[frame.BLEND]) * ns,
            visible_chunks=int(total[frame.VISIBLE_CHUNKS]),
            hidden_chunks=int(total[frame.HIDDEN_CHUNKS]),
            records=int(total[frame.RECORDS]),
            vectors=int(total[frame.VECTORS]),
            drawn=int(total[frame.DRAWN]),
        )

    def _render(
        self,
        camera: Camera,
        pixels: Pixels,
        rows: Rows | None,
        *,
        clock: int,
        surface: bool = False,
    ) -> Image:
        """Render; of surfaces, depth is 1 / depth, and the colours are what it was made of."""
        width, height = pixels.count(camera.width), pixels.count(camera.height)
        if width == 0 or height == 0:
            raise UsageError(
                f"{pixels} selects no pixel of {camera.width}x{camera.height}",
                fix="use a larger image or a smaller stride",
            )
        if self._side > 1:
            if self._side * max(camera.width, camera.height) > MAX_SIDE:
                raise UsageError(
                    f"{camera.width}x{camera.height} with four samples a pixel is too large",
                    fix=f"give at most {MAX_SIDE // self._side} pixels a side, or one sample",
                )
            pixels = pixels.times(self._side)
            width, height = self._side * width, self._side * height
        first, end = (0, height) if rows is None else (self._side * row for row in rows)
        image = Image(
            rgb=np.empty((height, width, 3), dtype=np.float32),
            depth=np.empty((height, width), dtype=np.float32),
            alpha=np.empty((height, width), dtype=np.float32),
        )
        jobs = [
            (work, camera, pixels, (*columns, first, end), image, clock, surface)
            for work, columns in zip(self._works, _split(width, len(self._works)), strict=False)
        ]
        if self._pool is None or len(jobs) == 1:
            for job in jobs:
                self._draw(*job)
        else:
            list(self._pool.map(lambda job: self._draw(*job), jobs))
        if rows is not None:
            image = image.rows(first, end)
        return image if self._side == 1 else _mean_of_four(image)

    def _draw(
        self,
        work: _Workspace,
        camera: Camera,
        pixels: Pixels,
        window: Window,
        image: Image,
        clock: int,
        surface: bool,
    ) -> None:
        layout, preset = self.store.layout, self._preset
        is_sampled = self._side > 1
        columns, rows = _centres(pixels, *window[:2]), _centres(pixels, *window[2:])
        ray, lens = True if surface else self._ray, None
        if camera.distortion is None:
            view = view_vector(camera, pixels, window, near=self._near, samples=self._side)
        else:
            seen = lens_map(camera.lens, pixels, window, self._side)
            columns, rows = seen.columns, seen.rows
            ray, lens = True, (seen.tables, seen.blur, seen.place)
            pinhole = seen.camera(camera, camera.near if self._near is None else self._near)
            view = view_vector(pinhole, Pixels(), (0, pinhole.width, 0, pinhole.height))
        frame.draw(
            (layout.geometry, layout.dc, layout.sh, layout.bounds),
            layout.sh_count,
            view,
            columns,
            rows,
            (
                np.float32(SAMPLED_EPS2D if is_sampled else preset.eps2d),
                self._antialiased or is_sampled,
                np.float32(preset.min_compensation**2),
                np.float32(preset.max_alpha),
                ray,
                lens,
                CURVE,
                np.zeros(3, np.float32) if surface else self._background,
                _SLAB_CHUNKS,
                True if surface else None,
            ),
            work.arrays(window),
            (image.rgb, image.depth, image.alpha),
            work.statistics,
            clock,
        )
        if surface:
            (x0, x1, y0, y1), width = window, window[1] - window[0]
            x, y = columns[:width], rows[: y1 - y0, np.newaxis]
            if lens is not None:
                x, y = (each.reshape(-1, width + SLACK_COLUMNS) for each in (columns, rows))
                x, y = x[: y1 - y0, :width], y[: y1 - y0, :width]
            there = (slice(y0, y1), slice(x0, x1))
            plane, alpha = image.rgb[there], image.alpha[there]
            total = plane[..., 0] + plane[..., 1] * x + plane[..., 2] * y
            image.depth[there] = total / np.maximum(alpha, np.float32(1e-10))


def open_renderer(store: Store, backend: Backend = "cpu", **options: Any) -> Renderer:
    """Return a renderer for a store.

    Args:
        store: compiled Gaussians.
        backend: "cpu", or "cuda" for gsplat on a CUDA device; neither stands in for the other.
        options: those of the backend's class.

    Raises:
        UsageError: for an unknown backend, or options that it does not have.
        PrerequisiteError: when the backend's packages or device are missing.
    """
    if backend == "cpu":
        return CpuRenderer(store, **options)
    if backend == "cuda":
        from nw_splat.cuda import CudaRenderer

        _refuse_other_pictures(options)
        return CudaRenderer(store, **options)
    raise UsageError(f"unknown renderer {backend!r}", fix=nearest(backend, ("cpu", "cuda")))


def _refuse_other_pictures(options: dict[str, Any]) -> None:
    """Refuse what the cuda renderer cannot draw, and take out what it draws anyway."""
    usual = {"projection": "ewa", "samples": 1, "near": None}
    for name, value in usual.items():
        asked = options.pop(name, value)
        if asked != value and (name, asked) != ("near", Camera.near):
            raise UsageError(
                f"--render cuda cannot draw with {name} {asked}",
                fix=f"use --render cpu, or {name} {value or Camera.near}",
            )


def _mean_of_four(image: Image) -> Image:
    """Average 2x2 samples; depth is weighted by what each of them covers."""
    height, width = (side // 2 for side in image.alpha.shape)
    mean = Image(
        rgb=np.empty((height, width, 3), dtype=np.float32),
        depth=np.empty((height, width), dtype=np.float32),
        alpha=np.empty((height, width), dtype=np.float32),
    )
    insert.mean_of_four(image.rgb, image.depth, image.alpha, mean.rgb, mean.depth, mean.alpha)
    return mean


class _Workspace:
    """Arrays that frames reuse. Untouched pages of the large ones cost no memory."""

    def __init__(self, store: Store) -> None:
        gaussians = store.chunks * CHUNK
        chunks = max(store.chunks, 1)
        self._keys = np.empty(max(gaussians, chunks), dtype=np.int64)
        self._scratch = np.empty_like(self._keys)
        self._carried = np.empty_like(self._keys)
        self._chunk_keys = np.empty(chunks, dtype=np.int64)
        self._nearest = np.empty(chunks, dtype=np.float32)
        self._records = _aligned((gaussians + GROUP) * RECORD)
        self._depths = np.empty(gaussians, dtype=np.float32)
        self._histogram = np.empty(HISTOGRAM, dtype=np.int64)
        self._light = np.empty(0, dtype=np.float32)
        self._paint = np.empty(0, dtype=np.float32)
        self._live = np.empty(0, dtype=np.int64)
        self._shape = (0, 0)
        self.statistics = np.zeros(frame.STATISTICS, dtype=np.int64)

    def arrays(self, window: Window) -> tuple[NDArray[Any], ...]:
        """Return the arrays for a window of this size, in the order that `draw` takes them."""
        width, height = window[1] - window[0], window[3] - window[2]
        if self._shape != (width, height):
            self._shape = (width, height)
            size = (height + SLACK_ROWS) * (width + SLACK_COLUMNS)
            self._light = _aligned(size)
            self._paint = _aligned(size * CHANNELS)
            self._live = np.empty(((width + 7) // 8 + 1) * ((height + 7) // 8 + 1), dtype=np.int64)
        return (
            self._keys,
            self._scratch,
            self._carried,
            self._chunk_keys,
            self._nearest,
            self._records,
            self._depths,
            self._histogram,
            self._light,
            self._paint,
            self._live,
        )


def _split(width: int, parts: int) -> list[tuple[int, int]]:
    """Cut columns into at most `parts` windows of whole 8-column blocks."""
    blocks = -(-width // 8)
    parts = min(parts, blocks)
    edges = [min(width, 8 * (blocks * i // parts)) for i in range(parts + 1)]
    return list(pairwise(edges))


@lru_cache(maxsize=64)
def _centres(pixels: Pixels, first: int, end: int) -> NDArray[np.float32]:
    """Centres of the pixels first..end-1 taken along a side, with the slack of vector loads."""
    indices = np.array([pixels.index(number) for number in range(first, end)])
    return np.concatenate([indices + 0.5, np.zeros(PIXELS)]).astype(np.float32)


def _aligned(size: int) -> NDArray[np.float32]:
    """Floats that begin with a cache line: records and vectors then lie in as few as can be."""
    line = 64 // 4
    array = np.empty(size + line, dtype=np.float32)
    first = -(array.ctypes.data // 4) % line
    return array[first : first + size]
