"""A picture of Gaussians against its photograph: what training minimises, and figures of a view.

Training minimises the photometric loss of the 3DGS paper, and depth where there is some. Each
photograph has an affine map of colours, as the paper's code has it since 2024: a camera's automatic
exposure and white balance change from one photograph to the next; what does not belong to the scene
is learnt here: colour' = A colour + b, first the identity.

Unlike there, the mean of all maps stays the identity: what photographs have in common belongs to
the scene. Left free, the maps learn faster than the scene does, and take its contrast: views that
no photograph was taken of, which have no map, came out 7 dB worse for it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_splat.gaussians import Gaussians
from nw_twin.gaussians.images import F32, Images, Photo
from nw_twin.gaussians.kernels.rows import RADIUS, SLOPES, adam, photo_gradient, ssim_slopes
from nw_twin.gaussians.rasteriser import Rasteriser, Threads

DEVIATION = 1.5
"""Of the window of structural similarity, in pixels."""

_BAND = 48
"""Rows that one job handles."""

_EPSILON = 1e-8


@dataclass(frozen=True, kw_only=True)
class Compared:
    """Loss of one view and its gradient.

    Attributes:
        value: the loss.
        l1: mean absolute difference.
        ssim: mean structural similarity.
        depth: the weighted term of depth.
        upstream: gradient with respect to the images.
        to_map: (3, 4) gradient with respect to the photograph's map of colours; None without maps.
    """

    value: float
    l1: float
    ssim: float
    depth: float
    upstream: Images
    to_map: F32 | None


def compare(
    images: Images,
    photo: Photo,
    *,
    number: int,
    exposures: Exposures | None,
    ssim_weight: float,
    depth_weight: float,
    workers: Threads,
) -> Compared:
    """Compare a rendered image with a photograph.

    Args:
        images: as rendered by the photograph's camera.
        photo: the target image.
        number: of the photograph, for its exposure.
        exposures: maps of colours; None to compare colours as they are.
        ssim_weight: share of structural similarity.
        depth_weight: of the mean difference of inverse depth, where the photograph has some.
        workers: threads that share the work.
    """
    seen = images.rgb if exposures is None else exposures.apply(number, images.rgb)
    wanted = photo.planes()
    if photo.mask is not None:
        wanted = np.where(photo.mask, wanted, seen)
    photometric = photo_loss(seen, wanted, ssim_weight=ssim_weight, workers=workers)
    to_picture, to_map = photometric.gradient, None
    if photo.mask is not None:  # Windows of similarity reach over its edge.
        to_picture *= photo.mask
    if exposures is not None:
        to_picture, to_map = exposures.back(number, images.rgb, to_picture)
    depth, to_depth = 0.0, np.zeros_like(images.inverse_depth)
    if photo.inverse_depth is not None and depth_weight > 0.0:
        sure = photo.confidence
        if sure is None:
            sure = np.ones_like(photo.inverse_depth)
        depth, to_depth = depth_loss(images.inverse_depth, photo.inverse_depth, sure, depth_weight)
    return Compared(
        value=photometric.value + depth,
        l1=photometric.l1,
        ssim=photometric.ssim,
        depth=depth,
        upstream=Images(rgb=to_picture, alpha=np.zeros_like(images.alpha), inverse_depth=to_depth),
        to_map=to_map,
    )


@dataclass(frozen=True, kw_only=True)
class PhotoLoss:
    """(1 - w) l1 + w (1 - ssim), and its terms.

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


class Exposures:
    """The maps of all photographs.

    Args:
        count: photographs.

    Attributes:
        maps: (P, 3, 4) float32: A and b.
        mean: (P, 3, 4) float32, first moments.
        square: (P, 3, 4) float32, second moments.
        steps: (P,) int64 steps taken with each.
    """

    def __init__(self, count: int) -> None:
        self.maps = np.tile(np.eye(3, 4, dtype=np.float32), (count, 1, 1))
        self.mean, self.square = np.zeros_like(self.maps), np.zeros_like(self.maps)
        self.steps = np.zeros(count, dtype=np.int64)

    def apply(self, photo: int, rgb: F32) -> F32:
        """Return the picture (3, H, W) as that photograph's camera would have shown it."""
        # Not by BLAS, whose sums depend on the number of its threads.
        mapped = np.einsum("dc,cyx->dyx", self.maps[photo, :, :3], rgb)
        return mapped + self.maps[photo, :, 3, None, None]

    def back(self, photo: int, rgb: F32, gradient: F32) -> tuple[F32, F32]:
        """Return the gradients with respect to the picture and to the map.

        Args:
            photo: number of the photograph.
            rgb: (3, H, W) as rendered.
            gradient: (3, H, W) with respect to what `apply` returned.
        """
        to_map = np.empty((3, 4), dtype=np.float32)
        to_map[:, :3] = np.einsum("dyx,cyx->dc", gradient, rgb, dtype=np.float64)
        to_map[:, 3] = gradient.sum(axis=(1, 2), dtype=np.float64)
        return np.einsum("dc,dyx->cyx", self.maps[photo, :, :3], gradient), to_map

    def move(self, photo: int, gradient: F32, rate: float) -> None:
        """Take one step of Adam with a photograph's map, and make the mean of all the identity."""
        self.steps[photo] += 1
        arrays = (self.maps[photo], gradient, self.mean[photo], self.square[photo])
        rows = tuple(array.reshape(1, 12) for array in arrays)
        adam(rows, 12, (rate, rate), _EPSILON, int(self.steps[photo]), 0, 1)
        self.maps -= self.maps.mean(axis=0) - np.eye(3, 4, dtype=np.float32)


@dataclass(frozen=True, kw_only=True)
class ViewFigures:
    """One photograph against what Gaussians show in its place.

    Attributes:
        name: of the photograph.
        psnr: in dB, the picture clamped to 0..1, where the mask lets one see.
        psnr_corrected: the same after the affine map of colours that fits best: what is left when
            another exposure is no fault.
        ssim: mean structural similarity; what a mask hides counts as alike.
    """

    name: str
    psnr: float
    psnr_corrected: float
    ssim: float


def view_figures(gaussians: Gaussians, photo: Photo, rasteriser: Rasteriser) -> ViewFigures:
    """Return the figures of one view.

    Args:
        gaussians: as trained.
        photo: one that training did not see.
        rasteriser: with the background and the choices that they were trained with.
    """
    picture = np.clip(rasteriser.render(gaussians, photo.camera).rgb, 0.0, 1.0)
    wanted = photo.planes()
    shown = np.ones(wanted.shape[1:], dtype=bool) if photo.mask is None else photo.mask
    corrected = _corrected(picture[:, shown], wanted[:, shown])
    return ViewFigures(
        name=photo.name,
        psnr=psnr(picture[:, shown], wanted[:, shown]),
        psnr_corrected=psnr(corrected, wanted[:, shown]),
        ssim=photo_loss(picture, np.where(shown, wanted, picture)).ssim,
    )


def _corrected(colours: F32, wanted: F32) -> F32:
    """Return colours (3, n) after the affine map that takes them nearest to those wanted."""
    ones = np.ones((1, colours.shape[1]))
    basis = np.concatenate([colours, ones]).astype(np.float64)
    # A picture of few colours leaves the map open; then it stays near the identity.
    ridge = 1e-6 * colours.shape[1] * np.eye(4)
    start = np.eye(3, 4)
    gram = np.einsum("ip,jp->ij", basis, basis) + ridge
    target = np.einsum("ip,jp->ij", wanted.astype(np.float64), basis) + start @ ridge
    fitted = np.linalg.solve(gram, target.T).T
    return np.einsum("ij,jp->ip", fitted, basis).astype(np.float32)
