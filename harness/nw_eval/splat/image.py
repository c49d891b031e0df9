"""What a renderer returns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True)
class Image:
    """One rendered view; the arrays belong to whoever receives it.

    Attributes:
        rgb: (H, W, 3) float32 over the background; 0 and above, not clamped at 1.
        depth: (H, W) float32 expected depth along the optical axis in camera units: the blend's
            weighted mean; 0 where nothing was drawn.
        alpha: (H, W) float32 coverage, 0 to 1.
    """

    rgb: NDArray[np.float32]
    depth: NDArray[np.float32]
    alpha: NDArray[np.float32]

    def bytes(self) -> NDArray[np.uint8]:
        """Return (H, W, 3) uint8: clamped to 0..1, times 255, truncated as the field's tools do."""
        return (np.clip(self.rgb, 0.0, 1.0) * np.float32(255.0)).astype(np.uint8)
