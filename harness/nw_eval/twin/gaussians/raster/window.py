"""Some columns of a frame: what touches them, how it is blended, and the gradient of that."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.splat.camera import Camera, Pixels, view_vector
from nw_eval.splat.kernels.blend import (
    CHANNELS,
    CURVE,
    PIXELS,
    SLACK_COLUMNS,
    SLACK_ROWS,
    blend,
    clear,
)
from nw_eval.splat.kernels.project import RECORD
from nw_eval.twin.gaussians.kernels.blend_back import (
    GRADIENT,
    PLANES,
    blend_back,
    lay_planes,
    resolve,
)
from nw_eval.twin.gaussians.kernels.gather import gather, scatter
from nw_eval.twin.gaussians.raster.images import F32, Images


class Window:
    """Columns left..right-1 of a camera's image.

    Args:
        camera: of the whole image.
        left: first column, a multiple of 8.
        right: behind the last one.
        most_alpha: alpha is clamped to it.
    """

    def __init__(self, camera: Camera, left: int, right: int, most_alpha: float) -> None:
        self._place = (left, right, camera.height)
        self._view = view_vector(camera, Pixels(), (left, right, 0, camera.height))
        self._columns, self._rows = _centres(left, right), _centres(0, camera.height)
        self._most_alpha = np.float32(most_alpha)
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
            self._place[0],
            planes,
            self._stride,
            self._most_alpha,
            CURVE,
            self._gradient,
        )

    def add_to(self, screen: NDArray[Any]) -> None:
        """Add the gradients of `walk` to the rows (N, GRADIENT) of those whom they belong to."""
        scatter(self._gradient, self._owners, self._count, screen.reshape(-1), GRADIENT)


def _centres(first: int, end: int) -> F32:
    """Pixel-centre coordinates with the slack that vector loads touch."""
    return np.concatenate([np.arange(first, end) + 0.5, np.zeros(PIXELS)]).astype(np.float32)
