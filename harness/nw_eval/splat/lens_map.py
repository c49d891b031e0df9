"""Through a lens: where its pixels lie in the picture of a pinhole, for the kernels.

Along the ray, a Gaussian's response depends on a pixel only by the point where the pixel's ray
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
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from nw_eval.lens import Intrinsics
from nw_eval.splat.camera import MAX_SIDE, Camera, Pixels, Window
from nw_eval.splat.kernels.blend import SLACK_COLUMNS, SLACK_ROWS

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
