"""Plane sweep: how well a picture's neighbours match it on planes at many depths.

A plane at depth d that faces the camera maps its pixels to a neighbour's by the homography
K' (R + t n' / d) K^-1 (Collins 1996); there windows are compared by normalised cross correlation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nw_eval.twin.reconstruct.options import DepthOptions
from nw_eval.twin.reconstruct.packages import package
from nw_eval.twin.reconstruct.sweep_kernels import COST, NOISE, keep_best, smooth, to_costs, winners
from nw_eval.twin.reconstruct.views import F32, F64, WorkingView

_AT_ONCE = 16
"""Planes whose scores are held before they go to the volume, whose last axis is depth."""

HALF_PIXEL = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
"""From OpenCV's pixels, where the first one's centre is (0, 0), to ours."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Sweep:
    """What one sweep found. All arrays are (H, W) float32.

    Attributes:
        depth: along the optical axis, in the capture's unit; known everywhere, right or wrong.
        likeness: normalised cross correlation, -1 to 1.
        unique: 0 to 1, how much worse all other depths match.
    """

    depth: F32
    likeness: F32
    unique: F32


def sweep(
    view: WorkingView,
    others: Sequence[WorkingView],
    reach: tuple[float, float],
    options: DepthOptions,
) -> Sweep:
    """Measure depth in one view by the others.

    Args:
        view: of which depth is asked.
        others: at least one.
        reach: nearest and farthest depth.
        options: of the sweep and of the smoothing.
    """
    inverse = np.linspace(1.0 / reach[1], 1.0 / reach[0], options.planes)
    volume = _costs(view, others, inverse, options)
    total = np.zeros_like(volume)
    smooth(volume, view.grey, round(options.step * COST), round(options.jump * COST), total)
    plane, likeness, unique = (np.empty(view.size, np.float32) for _ in range(3))
    winners(volume, total, plane, likeness, unique)
    gap = inverse[1] - inverse[0]
    depth = (1.0 / (inverse[0] + gap * plane.astype(np.float64))).astype(np.float32)
    return Sweep(depth=depth, likeness=likeness, unique=unique)


def _costs(
    view: WorkingView, others: Sequence[WorkingView], inverse: F64, options: DepthOptions
) -> np.ndarray[tuple[int, int, int], np.dtype[np.uint16]]:
    """Return the costs of all planes, (H, W, D)."""
    height, width = view.size
    own, window = view.grey, PixelWindow(options.window)
    mean = window.mean(own)
    spread = np.maximum(window.mean(own * own) - mean * mean, 0.0)
    scale = (1.0 / np.sqrt(spread + NOISE)).astype(np.float32)
    neighbours = [(other.grey, *_pixels(view, other)) for other in others]
    volume = np.empty((height, width, len(inverse)), np.uint16)
    buffers = [np.empty((height, width), np.float32) for _ in range(5)]
    scores = np.empty((2, _AT_ONCE, height, width), np.float32)
    for first in range(0, len(inverse), _AT_ONCE):
        planes = inverse[first : first + _AT_ONCE]
        scores[:] = -1.0
        for n, plane in enumerate(planes):
            for grey, move, shift in neighbours:
                H = move.copy()
                H[:, 2] += shift * plane
                warped = window.warp(grey, H, buffers[0])
                np.multiply(own, warped, out=buffers[1])
                np.multiply(warped, warped, out=buffers[2])
                product = window.mean(buffers[1], buffers[3])
                square = window.mean(buffers[2], buffers[4])
                keep_best(
                    scale, mean, product, square, window.mean(warped, buffers[1]),
                    scores[0, n], scores[1, n],
                )  # fmt: skip
        best = scores[0 if options.best == 1 or len(others) == 1 else 1, : len(planes)]
        to_costs(scores[0, : len(planes)], best, first, volume)
    return volume


def _pixels(view: WorkingView, other: WorkingView) -> tuple[F64, F64]:
    """Return the two parts of the homography as OpenCV counts pixels."""
    move, shift = view.to(other)
    back = np.linalg.inv(HALF_PIXEL)
    # n' K^-1 is (0, 0, 1): the plane's part of the homography goes to the last column, which the
    # half pixels of this side do not reach.
    return back @ move @ HALF_PIXEL, back @ shift


class PixelWindow:
    """OpenCV's warps and means of windows, into arrays that are there already."""

    def __init__(self, side: int) -> None:
        self._cv2, self._side = package("cv2"), (side, side)

    def warp(self, picture: F32, H: F64, out: F32) -> F32:
        """Return the picture as its homography shows it; what is outside is grey, 0."""
        cv2 = self._cv2
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return cv2.warpPerspective(picture, H, out.shape[::-1], out, flags)

    def mean(self, picture: F32, out: F32 | None = None) -> F32:
        """Return the mean of the window about each pixel."""
        return self._cv2.boxFilter(picture, -1, self._side, out)
