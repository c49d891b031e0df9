"""The renderer for training: pictures of Gaussians, and gradients back to them.

Sorting and blending are the shipped renderer's own compiled code, so that what is trained is what
will be rendered; only the projection is another, in double precision, since Gaussians change with
every step and are not arranged in a store. Pictures are made in windows of `WINDOW` columns, and
sums are taken window by window: the bits do not depend on the number of threads.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import UsageError
from nw_eval.splat.cameras.camera import Camera
from nw_eval.splat.cameras.pixels import Pixels
from nw_eval.splat.cameras.presets import PresetName, get_preset
from nw_eval.splat.gaussians import SH_COUNTS, Gaussians
from nw_eval.splat.kernels.blend import CURVE, SLACK_COLUMNS, SLACK_ROWS, blend, clear
from nw_eval.splat.kernels.records import RECORD
from nw_eval.splat.kernels.shapes import CHANNELS, PIXELS
from nw_eval.splat.kernels.sort import HISTOGRAM, sort_nearer
from nw_eval.splat.kernels.view import view_vector
from nw_eval.twin.gaussians.images import Gradients, Images
from nw_eval.twin.gaussians.kernels.blend_back import (
    G_U,
    GRADIENT,
    PLANES,
    blend_back,
    lay_planes,
    resolve,
)
from nw_eval.twin.gaussians.kernels.gather import gather, scatter
from nw_eval.twin.gaussians.kernels.project import project
from nw_eval.twin.gaussians.kernels.project_back import project_back
from nw_eval.twin.gaussians.workers import Workers

WINDOW = 80
"""Columns of a window, a multiple of the renderer's 8-pixel blocks: four at 320 pixels share out
well over two threads, and a splat in two windows is walked twice."""

F32 = NDArray[np.float32]


class Rasteriser:
    """Renders Gaussians and takes gradients back to them; belongs to one thread.

    Args:
        preset: which gsplat's numerical choices.
        antialiased: compensate opacity for the blur of small splats.
        background: colour behind everything.
        workers: the threads that share a frame; by default none but the caller's.
    """

    def __init__(
        self,
        *,
        preset: PresetName = "gsplat-1.5",
        antialiased: bool = True,
        background: tuple[float, float, float] = (1.0, 1.0, 1.0),
        workers: Workers | None = None,
    ) -> None:
        self._preset = get_preset(preset)
        self._options = (self._preset.eps2d, antialiased, self._preset.min_compensation**2)
        self._background = np.asarray(background, dtype=np.float32)
        self._workers = workers or Workers()
        self._room = _Room(0)
        self._frame: _Frame | None = None

    def render(self, gaussians: Gaussians, camera: Camera, *, sh_degree: int = 3) -> Images:
        """Return what a camera sees; the caller owns the arrays.

        Args:
            gaussians: what to render.
            camera: from where.
            sh_degree: degree up to which harmonics are used, as far as there are any.
        """
        if len(gaussians) > self._room.count:
            self._room = _Room(len(gaussians))
        room, n = self._room, len(gaussians)
        used = min(SH_COUNTS[sh_degree], gaussians.sh.shape[1])
        whole = view_vector(camera, Pixels(), (0, camera.width, 0, camera.height))
        view = whole.astype(np.float64)
        arrays = tuple(getattr(gaussians, field.name) for field in fields(gaussians))

        def project_block(first: int, end: int) -> None:
            project(*arrays, used, view, self._options, first, end, room.records, room.depths)

        self._workers.over(n, project_block)
        # Those that are not shown are infinitely far: they are not nearer than infinity.
        shown, in_scratch, _ = sort_nearer(
            room.depths,
            n,
            np.float32(np.inf),
            room.keys,
            room.scratch,
            room.carried,
            room.histogram,
        )
        images = Images.empty(camera.width, camera.height)
        windows = [
            _Window(left, min(left + WINDOW, camera.width), camera)
            for left in range(0, camera.width, WINDOW)
        ]
        ordered = room.scratch if in_scratch else room.keys

        def draw(window: _Window) -> Callable[[], None]:
            return lambda: self._draw(window, ordered, shown, images)

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

        def walk(window: _Window) -> Callable[[], None]:
            return lambda: self._walk(window, upstream, frame.images)

        self._workers.run([walk(window) for window in frame.windows])
        n = len(frame.arrays[0])
        screen = np.zeros((n, GRADIENT), dtype=np.float32)
        for window in frame.windows:
            scatter(window.gradient, window.owners, window.count, screen.reshape(-1), GRADIENT)
        out = tuple(np.empty_like(array) for array in frame.arrays)
        depths = self._room.depths

        def block(first: int, end: int) -> None:
            project_back(
                *frame.arrays,
                frame.used,
                frame.view,
                self._options,
                first,
                end,
                depths,
                screen,
                out,
            )

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

    def _draw(self, window: _Window, ordered: Any, shown: int, images: Images) -> None:
        records = np.empty((shown + 8) * RECORD, dtype=np.float32)
        owners = np.empty(shown, dtype=np.int64)
        found = gather(
            self._room.records, ordered, shown, window.left, window.right, records, owners
        )
        window.records, window.owners, window.count = records, owners, found
        width, height = window.right - window.left, window.camera.height
        stride = width + SLACK_COLUMNS
        size = (height + SLACK_ROWS) * stride
        light = np.empty(size, dtype=np.float32)
        paint = np.empty(size * CHANNELS, dtype=np.float32)
        blocks = (width + 7) // 8 + 1
        live = np.empty(blocks * ((height + 7) // 8 + 1), dtype=np.int64)
        clear(light, paint, stride, width, height, live, blocks)
        blend(
            records,
            self._room.counting,
            found,
            *window.centres,
            light,
            paint,
            stride,
            live,
            blocks,
            window.view,
            np.float32(self._preset.max_alpha),
            CURVE,
        )
        resolve(light, paint, window.place, self._background, *images.arrays())

    def _walk(self, window: _Window, upstream: Images, images: Images) -> None:
        stride = window.right - window.left + SLACK_COLUMNS
        planes = np.empty((window.camera.height + SLACK_ROWS) * stride * PLANES, dtype=np.float32)
        lay_planes(planes, stride, window.place, upstream.arrays(), images.arrays())
        window.gradient = np.empty(window.count * GRADIENT, dtype=np.float32)
        blend_back(
            window.records,
            window.count,
            window.centres,
            window.left,
            planes,
            stride,
            np.float32(self._preset.max_alpha),
            CURVE,
            window.gradient,
        )


class _Room:
    """Arrays that frames of up to `count` Gaussians reuse."""

    def __init__(self, count: int) -> None:
        self.count = count
        self.records = np.empty((count + 8) * RECORD, dtype=np.float32)
        self.depths = np.empty(count, dtype=np.float32)
        self.keys = np.empty(count + 1, dtype=np.int64)
        self.scratch = np.empty(count + 1, dtype=np.int64)
        self.carried = np.empty(count + 1, dtype=np.int64)
        self.counting = np.arange(count + 1, dtype=np.int64)
        self.histogram = np.empty(HISTOGRAM, dtype=np.int64)


class _Window:
    """Some columns of a frame: the records that touch them, and the gradients of these."""

    def __init__(self, left: int, right: int, camera: Camera) -> None:
        self.left, self.right, self.camera = left, right, camera
        self.view = view_vector(camera, Pixels(), (left, right, 0, camera.height))
        self.centres = _centres(left, right), _centres(0, camera.height)
        self.records = self.gradient = np.empty(0, dtype=np.float32)
        self.owners = np.empty(0, dtype=np.int64)
        self.count = 0

    @property
    def place(self) -> tuple[int, int, int]:
        """(first column, behind the last one, height)."""
        return self.left, self.right, self.camera.height


@dataclass(frozen=True, kw_only=True)
class _Frame:
    """What the gradient needs of the last rendering."""

    arrays: tuple[F32, ...]
    used: int
    view: NDArray[np.float64]
    windows: list[_Window]
    images: Images


def _centres(first: int, end: int) -> F32:
    """Pixel-centre coordinates with the slack that vector loads touch."""
    return np.concatenate([np.arange(first, end) + 0.5, np.zeros(PIXELS)]).astype(np.float32)
