"""A rendered view against its photograph: the loss, and its gradient to picture and exposure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nw_eval.twin.gaussians.exposure import Exposures
from nw_eval.twin.gaussians.loss import depth_loss, photo_loss
from nw_eval.twin.gaussians.photo import Photo
from nw_eval.twin.gaussians.raster.images import F32, Images
from nw_eval.twin.gaussians.raster.threads import Threads


@dataclass(frozen=True, kw_only=True)
class Compared:
    """What one view says.

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
    """Compare what was rendered with a photograph.

    Args:
        images: as rendered by the photograph's camera.
        photo: what is wanted.
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
