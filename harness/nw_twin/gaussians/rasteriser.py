"""The renderer for training: pictures of Gaussians, and gradients back to them.

Sorting and blending are the shipped renderer's own compiled code, so that what is trained is what
will be rendered; only the projection is another, in double precision, since Gaussians change with
every step and are not arranged in a store. Pictures are made in windows of `WINDOW` columns, and
sums are taken window by window: the bits do not depend on the number of threads.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import UsageError
from nw_base.words import Projection
from nw_splat.camera import Camera, Pixels, PresetName, get_preset, view_vector
from nw_splat.gaussians import SH_COUNTS, Gaussians
from nw_splat.kernels import view as at
from nw_splat.kernels.blend import (
    CHANNELS,
    CURVE,
    PIXELS,
    SLACK_COLUMNS,
    SLACK_ROWS,
    blend,
    clear,
)
from nw_splat.kernels.draw import HISTOGRAM, sort_nearer
from nw_splat.kernels.project import RECORD
from nw_twin.gaussians.images import F32, Gradients, Images
from nw_twin.gaussians.kernels.blend import (
    G_U,
    GRADIENT,
    PLANES,
    blend_back,
    gather,
    lay_planes,
    resolve,
    scatter,
)
from nw_twin.gaussians.kernels.project import project
from nw_twin.gaussians.kernels.project_back import project_back

WINDOW = 80
"""Columns of a window, a multiple of the renderer's 8-pixel blocks: four at 320 pixels share out
well over two threads. A splat in two windows is walked twice."""

_BLOCK = 4096
"""Gaussians that one job handles."""


class Rasteriser:
    """Renders Gaussians and takes gradients back to them; belongs to one thread.

    Args:
        preset: which gsplat's numerical choices.
        antialiased: compensate opacity for the blur of small splats.
        projection: "ray" or "ewa"; see the shipped renderer.
        background: colour behind everything.
        workers: the threads that share a frame; by default none but the caller's.
    """

    def __init__(
        self,
        *,
        preset: PresetName = "gsplat-1.5",
        antialiased: bool = True,
        projection: Projection = "ray",
        background: tuple[float, float, float] = (1.0, 1.0, 1.0),
        workers: Threads | None = None,
    ) -> None:
        self._preset = get_preset(preset)
        self._ray = None if projection == "ewa" else True
        floor2 = self._preset.min_compensation**2
        self._options = (self._preset.eps2d, antialiased, floor2, self._ray)
        self._background = np.asarray(background, dtype=np.float32)
        self._workers = workers or Threads()
        self._room = _Room(0)
        self._frame: _Frame | None = None

    def render(self, gaussians: Gaussians, camera: Camera, *, sh_degree: int = 3) -> Images:
        """Return the image of a camera; the caller owns the arrays.

        Args:
            gaussians: what to render.
            camera: from where.
            sh_degree: degree up to which harmonics are used, as far as there are any.
        """
        n, width = len(gaussians), camera.width
        if n > self._room.count:
            self._room = _Room(n)
        room = self._room
        used = min(SH_COUNTS[sh_degree], gaussians.sh.shape[1])
        view = view_vector(camera, Pixels(), (0, width, 0, camera.height)).astype(np.float64)
        if self._ray is not None:
            view[at.X_LOW : at.Y_HIGH + 1] = -np.inf, np.inf, -np.inf, np.inf
        arrays = _arrays(gaussians)

        def block(first: int, end: int) -> None:
            project(arrays, used, view, self._options, first, end, room.records, room.depths)

        self._workers.over(n, block)
        shown, ordered = room.sort(n)
        images = Images.empty(width, camera.height)
        windows = [
            Window(camera, left, min(left + WINDOW, width), self._preset.max_alpha, self._ray)
            for left in range(0, width, WINDOW)
        ]

        def draw(window: Window) -> Callable[[], None]:
            return lambda: window.draw(room.records, ordered, shown, self._background, images)

        self._workers.run([draw(window) for window in windows])
        self._frame = _Frame(arrays=arrays, used=used, view=view, windows=windows, images=images)
        return images

    def backward(self, upstream: Images) -> Gradients:
        """Return the gradients of a loss whose gradient to the last rendered images is `upstream`.

        Gaussians and images of the last `render` must be as they were.

        Raises:
            UsageError: nothing was rendered, or `upstream` is of another size.
        """
        frame = self._frame
        if frame is None:
            raise UsageError("no picture to take a gradient of", fix="call render first")
        if upstream.rgb.shape != frame.images.rgb.shape:
            raise UsageError(
                f"gradient has shape {upstream.rgb.shape}",
                fix=f"give {frame.images.rgb.shape}, as rendered",
            )

        def walk(window: Window) -> Callable[[], None]:
            return lambda: window.walk(upstream, frame.images)

        self._workers.run([walk(window) for window in frame.windows])
        n, depths = len(frame.arrays[0]), self._room.depths
        screen = np.zeros((n, GRADIENT), dtype=np.float32)
        for window in frame.windows:
            window.add_to(screen)
        out = tuple(np.empty_like(array) for array in frame.arrays)

        def block(first: int, end: int) -> None:
            options = (self._options, first, end, depths, screen, out)
            project_back(frame.arrays, frame.used, frame.view, *options)

        self._workers.over(n, block)
        means, log_scales, quats, opacity_logits, sh = out
        return Gradients(
            means=means,
            log_scales=log_scales,
            quats=quats,
            opacity_logits=opacity_logits,
            sh=sh,
            centres=screen[:, G_U : G_U + 2].copy(),
            visible=np.isfinite(depths[:n]),
        )


class _Room:
    """Arrays that frames of up to `count` Gaussians reuse."""

    def __init__(self, count: int) -> None:
        self.count = count
        self.records = np.empty((count + 8) * RECORD, dtype=np.float32)
        self.depths = np.empty(count, dtype=np.float32)
        self._keys, self._scratch, self._carried = np.empty((3, count + 1), dtype=np.int64)
        self._histogram = np.empty(HISTOGRAM, dtype=np.int64)

    def sort(self, count: int) -> tuple[int, NDArray[np.int64]]:
        """Return how many of the first `count` are shown, and their keys, nearest first.

        Those that are not shown are infinitely far: they are not nearer than infinity.
        """
        work = (self._keys, self._scratch, self._carried, self._histogram)
        shown, in_scratch, _ = sort_nearer(self.depths, count, np.float32(np.inf), *work)
        return shown, self._scratch if in_scratch else self._keys


@dataclass(frozen=True, kw_only=True)
class _Frame:
    """What the gradient needs of the last rendering."""

    arrays: tuple[F32, F32, F32, F32, F32]
    used: int
    view: NDArray[np.float64]
    windows: list[Window]
    images: Images


def _arrays(gaussians: Gaussians) -> Any:
    g = gaussians
    return g.means, g.log_scales, g.quats, g.opacity_logits, g.sh


class Window:
    """Columns left..right-1 of a camera's image.

    Args:
        camera: of the whole image.
        left: first column, a multiple of 8.
        right: behind the last one.
        most_alpha: alpha is clamped to it.
        ray: None for EWA, True along the ray.
    """

    def __init__(
        self, camera: Camera, left: int, right: int, most_alpha: float, ray: bool | None
    ) -> None:
        self._place = (left, right, camera.height)
        self._view = view_vector(camera, Pixels(), (left, right, 0, camera.height))
        self._columns, self._rows = _centres(left, right), _centres(0, camera.height)
        self._most_alpha, self._ray = np.float32(most_alpha), ray
        self._stride = right - left + SLACK_COLUMNS
        self._size = (camera.height + SLACK_ROWS) * self._stride
        self._records = self._gradient = np.empty(0, dtype=np.float32)
        self._owners = np.empty(0, dtype=np.int64)
        self._count = 0

    def draw(
        self, records: F32, ordered: NDArray[np.int64], shown: int, background: F32, images: Images
    ) -> None:
        """Blend what touches the window into the images.

        Args:
            records: of the whole frame.
            ordered: keys of those shown, nearest first.
            shown: how many.
            background: (3,) colour behind everything.
            images: of the whole frame; the window's part is written.
        """
        left, right, height = self._place
        width = right - left
        self._records = np.empty((shown + 8) * RECORD, dtype=np.float32)
        self._owners = np.empty(shown, dtype=np.int64)
        self._count = gather(records, ordered, shown, left, right, self._records, self._owners)
        light = np.empty(self._size, dtype=np.float32)
        paint = np.empty(self._size * CHANNELS, dtype=np.float32)
        blocks = (width + 7) // 8 + 1
        live = np.empty(blocks * ((height + 7) // 8 + 1), dtype=np.int64)
        clear(light, paint, self._stride, width, height, live, blocks)
        blend(
            self._records,
            np.arange(self._count, dtype=np.int64),
            self._count,
            self._columns,
            self._rows,
            light,
            paint,
            self._stride,
            live,
            blocks,
            self._view,
            self._most_alpha,
            self._ray,
            None,
            CURVE,
        )
        resolve(light, paint, self._place, background, images.arrays())

    def walk(self, upstream: Images, images: Images) -> None:
        """Take the gradient with respect to the records that `draw` blended.

        Args:
            upstream: gradient with respect to the images, of the whole frame.
            images: as drawn, of the whole frame.
        """
        planes = np.empty(self._size * PLANES, dtype=np.float32)
        lay_planes(planes, self._stride, self._place, upstream.arrays(), images.arrays())
        self._gradient = np.empty(self._count * GRADIENT, dtype=np.float32)
        blend_back(
            self._records,
            self._count,
            (self._columns, self._rows),
            self._view,
            planes,
            self._stride,
            self._most_alpha,
            self._ray,
            CURVE,
            self._gradient,
        )

    def add_to(self, screen: NDArray[Any]) -> None:
        """Add the gradients of `walk` to the rows (N, GRADIENT) of those whom they belong to."""
        scatter(self._gradient, self._owners, self._count, screen.reshape(-1), GRADIENT)


def _centres(first: int, end: int) -> F32:
    """Pixel-centre coordinates with the slack that vector loads touch."""
    return np.concatenate([np.arange(first, end) + 0.5, np.zeros(PIXELS)]).astype(np.float32)


class Threads:
    """Runs jobs that write to places of their own.

    Args:
        threads: how many at once.

    Raises:
        UsageError: fewer than one.
    """

    def __init__(self, threads: int = 1) -> None:
        if threads < 1:
            raise UsageError(f"threads is {threads}", fix="give 1 or more")
        self._pool = ThreadPoolExecutor(threads) if threads > 1 else None

    def run(self, jobs: list[Callable[[], None]]) -> None:
        """Run all jobs, in any order, and return when all are done."""
        if self._pool is None:
            for job in jobs:
                job()
        else:
            for done in [self._pool.submit(job) for job in jobs]:
                done.result()

    def over(self, count: int, job: Callable[[int, int], None]) -> None:
        """Run job(first, end) over all blocks of `count` items."""
        edges = [*range(0, count, _BLOCK), count]

        def bind(first: int, end: int) -> Callable[[], None]:
            return lambda: job(first, end)

        self.run([bind(first, end) for first, end in pairwise(edges)])
