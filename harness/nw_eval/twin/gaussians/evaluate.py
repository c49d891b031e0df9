"""How well Gaussians show what they were not trained on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nw_eval.splat.gaussians import Gaussians
from nw_eval.twin.gaussians.loss import photo_loss, psnr
from nw_eval.twin.gaussians.photo import Photo
from nw_eval.twin.gaussians.raster.images import F32
from nw_eval.twin.gaussians.raster.rasteriser import Rasteriser


@dataclass(frozen=True, kw_only=True)
class ViewFigures:
    """One photograph against what Gaussians show in its place.

    Attributes:
        name: of the photograph.
        psnr: in dB, the picture clamped to 0..1, where the mask lets one see.
        psnr_corrected: likewise after the affine map of colours that fits best: what is left when
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
