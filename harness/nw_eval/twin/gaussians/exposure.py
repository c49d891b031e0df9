"""One affine map of colours for each photograph, as the 3DGS paper's code has it since 2024.

A camera's automatic exposure and white balance change from one photograph to the next; what does
not belong to the place is learnt here: colour' = A colour + b, first the identity.

Unlike there, the mean of all maps stays the identity: what photographs have in common belongs to
the place. Left free, the maps learn faster than the place does, and take its contrast: views that
no photograph was taken of, which have no map, came out 7 dB worse for it.
"""

from __future__ import annotations

import numpy as np

from nw_eval.twin.gaussians.kernels.adam import adam
from nw_eval.twin.gaussians.raster.images import F32

_EPSILON = 1e-8


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
