"""Gaussians as a browser draws them: few enough, with covariances and one colour each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_eval.splat.gaussians import SH0, Gaussians

MOST = 200_000
"""More take a browser without a graphics card longer than a second a picture."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SplatPoints:
    """N Gaussians in one frame.

    Attributes:
        centers: (N, 3) float32.
        covariances: (N, 3, 3) float32.
        rgbs: (N, 3) float32, 0 to 1, without what depends on the direction.
        opacities: (N, 1) float32, 0 to 1.
    """

    centers: NDArray[np.float32]
    covariances: NDArray[np.float32]
    rgbs: NDArray[np.float32]
    opacities: NDArray[np.float32]

    def take(self, selection: NDArray[np.bool_]) -> SplatPoints:
        """Return the Gaussians at a mask (N,)."""
        return SplatPoints(
            centers=self.centers[selection],
            covariances=self.covariances[selection],
            rgbs=self.rgbs[selection],
            opacities=self.opacities[selection],
        )


def splat_points(
    gaussians: Gaussians, T_world_splat: NDArray[np.float64], *, most: int = MOST
) -> SplatPoints:
    """Return the Gaussians that are seen most, in the world.

    Args:
        gaussians: in the splat's frame.
        T_world_splat: (4, 4) similarity.
        most: how many are kept: those of the largest opacity times area.
    """
    opacity = 1 / (1 + np.exp(-np.clip(gaussians.opacity_logits.astype(np.float64), -60, 60)))
    deviations = np.exp(np.clip(gaussians.log_scales.astype(np.float64), -60, 20))
    ordered = np.sort(deviations, axis=1)
    weight = opacity * ordered[:, 1] * ordered[:, 2]
    whole = np.isfinite(gaussians.means).all(axis=1) & np.isfinite(weight)
    whole &= np.isfinite(gaussians.quats).all(axis=1) & (np.abs(gaussians.quats).sum(axis=1) > 0)
    order = np.argsort(np.where(whole, -weight, np.inf), kind="stable")
    kept = np.sort(order[: min(most, int(whole.sum()))])
    axes = T_world_splat[:3, :3] @ _rotations(gaussians.quats[kept].astype(np.float64))
    means = gaussians.means[kept].astype(np.float64)
    spread = axes * deviations[kept][:, None, :]
    return SplatPoints(
        centers=(means @ T_world_splat[:3, :3].T + T_world_splat[:3, 3]).astype(np.float32),
        covariances=(spread @ spread.transpose(0, 2, 1)).astype(np.float32),
        rgbs=np.clip(0.5 + SH0 * gaussians.sh[kept, 0], 0, 1).astype(np.float32),
        opacities=opacity[kept, None].astype(np.float32),
    )


def _rotations(quats: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotations (N, 3, 3) of quaternions (N, 4) w x y z of any length but 0."""
    w, x, y, z = (quats / np.linalg.norm(quats, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))
