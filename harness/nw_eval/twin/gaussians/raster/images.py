"""What training renders and what it is told about it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class Images:
    """One view as planes: as rendered, or the gradient of a loss with respect to that.

    Attributes:
        rgb: (3, H, W) float32 over the background.
        alpha: (H, W) float32 coverage.
        inverse_depth: (H, W) float32 sum of weight / depth, in inverse camera units; what the
            background shows counts as infinitely far.
    """

    rgb: F32
    alpha: F32
    inverse_depth: F32

    @classmethod
    def empty(cls, width: int, height: int) -> Images:
        """Return room for a view."""
        return cls(
            rgb=np.empty((3, height, width), dtype=np.float32),
            alpha=np.empty((height, width), dtype=np.float32),
            inverse_depth=np.empty((height, width), dtype=np.float32),
        )

    @classmethod
    def zeros(cls, width: int, height: int) -> Images:
        """Return zeros of a view's shapes."""
        images = cls.empty(width, height)
        for array in images.arrays():
            array[:] = 0.0
        return images

    def arrays(self) -> tuple[F32, F32, F32]:
        """Return (rgb, alpha, inverse depth), as the kernels take them."""
        return self.rgb, self.alpha, self.inverse_depth


@dataclass(frozen=True, kw_only=True)
class Gradients:
    """Gradients of a loss with respect to N Gaussians, named as the Gaussians' arrays are.

    Attributes:
        means: (N, 3) float32.
        log_scales: (N, 3) float32.
        quats: (N, 4) float32.
        opacity_logits: (N,) float32.
        sh: (N, K, 3) float32.
        centres: (N, 2) float32, with respect to the centres on the screen, per pixel.
        visible: (N,) bool: which the view shows; all is zero for the others.
    """

    means: F32
    log_scales: F32
    quats: F32
    opacity_logits: F32
    sh: F32
    centres: F32
    visible: NDArray[np.bool_]
