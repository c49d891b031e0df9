"""A photograph whose camera is known."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import UsageError
from nw_eval.splat.camera import Camera
from nw_eval.twin.gaussians.raster.images import F32


@dataclass(frozen=True, kw_only=True)
class Photo:
    """What a camera saw, and how far away it was where that is known.

    Attributes:
        name: for people.
        camera: without distortion.
        rgb: (H, W, 3) uint8 display values.
        inverse_depth: (H, W) float32, 1 / depth along the optical axis; None if nothing is known.
        confidence: (H, W) float32, 0 (not known) to 1; None for 1 everywhere.
        mask: (H, W) bool, where the picture shows the place; None for everywhere. Where it does
            not (people, what undistortion left empty), no colour is learnt.
    """

    name: str
    camera: Camera
    rgb: NDArray[np.uint8]
    inverse_depth: F32 | None = None
    confidence: F32 | None = None
    mask: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        """Check that everything has the size of the camera's image.

        Raises:
            UsageError: naming the photograph and what differs.
        """
        size = (self.camera.height, self.camera.width)
        if self.rgb.dtype != np.uint8 or self.rgb.shape != (*size, 3):
            raise UsageError(
                f"{self.name}: the picture is {self.rgb.dtype} of shape {self.rgb.shape}",
                fix=f"give uint8 of shape {(*size, 3)}, as its camera says",
            )
        for name in ("inverse_depth", "confidence", "mask"):
            array = getattr(self, name)
            if array is None:
                continue
            if array.shape != size or not np.isfinite(array).all():
                raise UsageError(
                    f"{self.name}: {name} has shape {array.shape} or is not finite",
                    fix=f"give finite numbers of shape {size}, with confidence 0 where not known",
                )

    def digest(self) -> str:
        """Return the hex sha256 of all that training takes from it."""
        camera = self.camera
        lens = (camera.fx, camera.fy, camera.cx, camera.cy, camera.near, camera.far)
        arrays = (self.rgb, self.inverse_depth, self.confidence, self.mask)
        content = hashlib.sha256(repr((self.rgb.shape, lens)).encode())
        content.update(camera.T_world_camera.tobytes())
        for array in arrays:
            content.update(b"-" if array is None else b"+")
            if array is not None:
                content.update(array.tobytes())
        return content.hexdigest()

    def planes(self) -> F32:
        """Return the picture as (3, H, W) float32, 0 to 1."""
        planes = self.rgb.transpose(2, 0, 1).astype(np.float32, order="C")
        planes *= np.float32(1.0 / 255.0)
        return planes


def extent_of(photos: Sequence[Photo]) -> float:
    """Return the size of a capture: 1.1 times the largest distance of a camera from their mean.

    The 3DGS paper's code takes lengths relative to it: the rate of the means, and what is large.
    Cameras in one place have none; then it is 1.
    """
    centres = np.array([photo.camera.T_world_camera[:3, 3] for photo in photos])
    extent = 1.1 * float(np.linalg.norm(centres - centres.mean(axis=0), axis=1).max())
    return extent if extent > 1e-6 else 1.0
