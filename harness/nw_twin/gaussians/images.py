"""Photographs whose cameras are known, the images that training renders, and gradients of both."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import UsageError
from nw_splat.camera import Camera

F32 = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class Photo:
    """A camera's photograph, with its depth where that is known.

    Attributes:
        name: for people.
        camera: without distortion.
        rgb: (H, W, 3) uint8 display values.
        inverse_depth: (H, W) float32, 1 / depth along the optical axis; None if nothing is known.
        confidence: (H, W) float32, 0 (not known) to 1; None for 1 everywhere.
        mask: (H, W) bool, where the picture shows the scene; None for everywhere. Where it does
            not (people, what undistortion left empty), no colour is learnt.
    """

    name: str
    camera: Camera
    rgb: NDArray[np.uint8]
    inverse_depth: F32 | None = None
    confidence: F32 | None = None
    mask: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        """Check all sizes against the camera's image; UsageError says what cannot be."""
        size = (self.camera.height, self.camera.width)
        if self.rgb.dtype != np.uint8 or self.rgb.shape != (*size, 3):
            raise UsageError(
                f"{self.name}: the picture is {self.rgb.dtype} of shape {self.rgb.shape}",
                fix=f"give uint8 of shape {(*size, 3)}, as its camera has",
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

    def halved(self) -> Photo:
        """Return it with half as many pixels each way; a last odd row or column is left out.

        Colours are means of four pixels, and known where the mask has all four. Depth is one
        pixel's: between two surfaces there is none.
        """
        height, width = self.rgb.shape[0] // 2, self.rgb.shape[1] // 2
        four = self.rgb[: 2 * height, : 2 * width].reshape(height, 2, width, 2, 3)
        rgb = ((four.sum(axis=(1, 3), dtype=np.uint16) + 2) // 4).astype(np.uint8)
        camera = self.camera
        half = {name: getattr(camera, name) / 2.0 for name in ("fx", "fy", "cx", "cy")}
        others = {
            name: None if array is None else np.ascontiguousarray(array[1::2, 1::2])
            for name, array in (
                ("inverse_depth", self.inverse_depth),
                ("confidence", self.confidence),
            )
        }
        mask = self.mask
        if mask is not None:
            mask = mask[: 2 * height, : 2 * width].reshape(height, 2, width, 2).all(axis=(1, 3))
        smaller = replace(camera, width=width, height=height, **half)
        return replace(self, camera=smaller, rgb=rgb, mask=mask, **others)

    def rays(self) -> NDArray[np.float64]:
        """Return (H, W, 3) unit vectors from the camera through the pixels, in the world."""
        return rays_of(self.camera)

    def planes(self) -> F32:
        """Return the picture as (3, H, W) float32, 0 to 1."""
        planes = self.rgb.transpose(2, 0, 1).astype(np.float32, order="C")
        planes *= np.float32(1.0 / 255.0)
        return planes


def rays_of(camera: Camera) -> NDArray[np.float64]:
    """Return (H, W, 3) unit vectors from a camera through the pixels, in the world."""
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    own = [(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)]
    rays = np.einsum("ij,jyx->yxi", camera.T_world_camera[:3, :3], np.stack(own))
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True)


def extent_of(photos: Sequence[Photo]) -> float:
    """Return the size of a capture: 1.1 times the largest distance of a camera from their mean.

    The 3DGS paper's code takes lengths relative to it: the rate of the means, and what is large.
    Cameras in one place have none; then it is 1.
    """
    centres = np.array([photo.camera.T_world_camera[:3, 3] for photo in photos])
    extent = 1.1 * float(np.linalg.norm(centres - centres.mean(axis=0), axis=1).max())
    return extent if extent > 1e-6 else 1.0


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
