"""What training minimises: photographs, and depth where there is some."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_eval.twin.gaussians.kernels.ssim import RADIUS, SLOPES, photo_gradient, ssim_slopes
from nw_eval.twin.gaussians.raster.images import F32
from nw_eval.twin.gaussians.raster.threads import Threads

DEVIATION = 1.5
"""Of the window of structural similarity, in pixels."""

_BAND = 48
"""Rows that one job handles."""


@dataclass(frozen=True, kw_only=True)
class PhotoLoss:
    """(1 - w) l1 + w (1 - ssim), and what it is made of.

    Attributes:
        value: the sum.
        l1: mean absolute difference.
        ssim: mean structural similarity.
        gradient: (3, H, W) float32 with respect to the picture.
    """

    value: float
    l1: float
    ssim: float
    gradient: F32


def photo_loss(
    picture: F32, photo: F32, *, ssim_weight: float = 0.2, workers: Threads | None = None
) -> PhotoLoss:
    """Compare a picture with a photograph as the 3DGS paper does (equation 7).

    Args:
        picture: (3, H, W) float32.
        photo: (3, H, W) float32.
        ssim_weight: w.
        workers: threads that share the work; the bits do not depend on them.
    """
    workers = workers or Threads()
    planes, height, width = picture.shape
    stride = -(-width // 8) * 8 + 16
    slopes = np.empty((planes, SLOPES * height * stride), dtype=np.float32)
    similar, apart = np.empty((2, planes, height))
    gradient = np.empty_like(picture)
    scale = 1.0 / picture.size
    scales = np.array([(1.0 - ssim_weight) * scale, -ssim_weight * scale], dtype=np.float32)
    window = _window()

    def slopes_job(c: int, first: int, end: int) -> Callable[[], None]:
        rows = (window, first, end, stride)
        return lambda: ssim_slopes(picture[c], photo[c], *rows, slopes[c], similar[c])

    def gradient_job(c: int, first: int, end: int) -> Callable[[], None]:
        rows = (window, first, end, stride)
        out = (slopes[c], scales, gradient[c], apart[c])
        return lambda: photo_gradient(picture[c], photo[c], *rows, *out)

    bands = [
        (c, first, min(first + _BAND, height))
        for c in range(planes)
        for first in range(0, height, _BAND)
    ]
    workers.run([slopes_job(*band) for band in bands])
    workers.run([gradient_job(*band) for band in bands])
    l1, ssim = float(apart.sum()) * scale, float(similar.sum()) * scale
    value = (1.0 - ssim_weight) * l1 + ssim_weight * (1.0 - ssim)
    return PhotoLoss(value=value, l1=l1, ssim=ssim, gradient=gradient)


def depth_loss(inverse: F32, target: F32, confidence: F32, weight: float) -> tuple[float, F32]:
    """Return weight * mean(confidence |inverse - target|) and its gradient.

    In inverse depth an error of a metre far away counts little, as parallax has it; what is not
    known has confidence 0.

    Args:
        inverse: (H, W) float32 rendered inverse depth.
        target: (H, W) float32 wanted, in the same unit.
        confidence: (H, W) float32, 0 to 1.
        weight: of this term.
    """
    apart = inverse - target
    scale = np.float32(weight / inverse.size)
    value = float((confidence * np.abs(apart)).sum(dtype=np.float64)) * weight / inverse.size
    return value, np.sign(apart) * confidence * scale


def psnr(picture: F32, photo: F32) -> float:
    """Return the peak signal-to-noise ratio in dB; peak 1, the picture clamped to 0..1."""
    error = np.mean((np.clip(picture, 0.0, 1.0) - photo).astype(np.float64) ** 2)
    return float(-10.0 * np.log10(max(error, 1e-12)))


def _window() -> NDArray[np.float32]:
    offsets = np.arange(-RADIUS, RADIUS + 1)
    weights = np.exp(-(offsets**2) / (2.0 * DEVIATION**2))
    return (weights / weights.sum()).astype(np.float32)
