"""Drawing objects that a splat lacks (cones, balls, the robot) into its image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import UsageError
from nw_eval.splat.image import Image

_NOTHING = 1e-3
"""Coverage below which a splat's expected depth means nothing."""


def composite(
    image: Image,
    rgb: NDArray[np.float32],
    depth: NDArray[np.float32],
    coverage: NDArray[np.float32],
    *,
    background: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> Image:
    """Blend drawn objects into a rendered image by depth.

    The splat of a pixel counts as one layer at its expected depth: an object before it hides it;
    an object behind it shows through what the splat leaves, in place of the background.

    Args:
        image: rendered (H, W) image.
        rgb: (H, W, 3) float32 colour of the objects.
        depth: (H, W) float32 their depth along the optical axis; inf where there is none.
        coverage: (H, W) float32 share of the pixel that they cover, 0 to 1.
        background: the colour that the image was rendered over.

    Returns:
        The blended image; depth is again the weighted mean, alpha includes the objects.

    Raises:
        UsageError: when shapes differ.
    """
    shape = image.depth.shape
    for name, array in (("rgb", rgb), ("depth", depth), ("coverage", coverage)):
        if array.shape[:2] != shape:
            raise UsageError(f"{name} has shape {array.shape}, the image {shape}")
    there = np.isfinite(depth)
    share = np.where(there, np.clip(coverage, 0.0, 1.0), 0.0).astype(np.float32)
    object_depth = np.where(there, depth, 0.0).astype(np.float32)
    before = (image.alpha < _NOTHING) | (object_depth < image.depth)
    through = 1.0 - image.alpha
    behind = image.rgb + through[..., None] * (rgb - np.asarray(background, dtype=np.float32))
    shown = np.where(before[..., None], rgb, behind)
    of_object = np.where(before, share, share * through)
    of_splat = np.where(before, (1.0 - share) * image.alpha, image.alpha)
    alpha = of_object + of_splat
    total = of_object * object_depth + of_splat * image.depth
    return Image(
        rgb=(image.rgb + share[..., None] * (shown - image.rgb)).astype(np.float32),
        depth=(total / np.maximum(alpha, 1e-10)).astype(np.float32),
        alpha=alpha.astype(np.float32),
    )


def paste(image: Image, rgb: NDArray[np.float32], mask: NDArray[np.bool_]) -> Image:
    """Replace the pixels of a mask, as the published evaluation does: no depth test, hard edges.

    Args:
        image: rendered (H, W) image.
        rgb: (H, W, 3) float32 colour of the objects.
        mask: (H, W) where they are seen.
    """
    return Image(
        rgb=np.where(mask[..., None], rgb, image.rgb).astype(np.float32),
        depth=image.depth.copy(),
        alpha=np.where(mask, 1.0, image.alpha).astype(np.float32),
    )
