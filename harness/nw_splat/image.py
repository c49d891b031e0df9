"""Images that a renderer returns, and operations on them.

Objects that a splat lacks (cones, balls, the robot) are drawn into it. A camera model gives it what
a real camera does to a picture: exposure, gain, blur and noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from nw_base import same_bits
from nw_base.errors import UsageError

Floating = TypeVar("Floating", np.float32, np.float64)


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

    def rows(self, first: int, end: int) -> Image:
        """Return rows first..end-1: views of these arrays."""
        return Image(
            rgb=self.rgb[first:end], depth=self.depth[first:end], alpha=self.alpha[first:end]
        )


def stacked(parts: Sequence[Image]) -> Image:
    """Return images of one width, from the top down, as one; a single one is itself."""
    if len(parts) == 1:
        return parts[0]
    return Image(
        rgb=np.concatenate([part.rgb for part in parts]),
        depth=np.concatenate([part.depth for part in parts]),
        alpha=np.concatenate([part.alpha for part in parts]),
    )


def exposed(images: Sequence[Image]) -> Image:
    """Return the mean of images in linear light, as an open shutter sees them; one stays as it is.

    A sensor adds light, not display values: colours are averaged between the sRGB curve's inverse
    and the curve, as in "Gaussian Splatting on the Move" (Seiskari et al., arXiv 2403.13327), where
    the curve is a power of 2.2. Values above white are clipped to white in each image.
    """
    if len(images) == 1:
        return images[0]
    share = np.float32(1.0 / len(images))
    light = np.zeros_like(images[0].rgb)
    alpha, weighted = np.zeros_like(images[0].alpha), np.zeros_like(images[0].alpha)
    for image in images:
        light += _decode(np.clip(image.rgb, 0.0, 1.0)) * share
        alpha += image.alpha * share
        weighted += image.alpha * image.depth * share
    # In double precision white stays white: bytes are truncated.
    return Image(
        rgb=_encode(light.astype(np.float64)).astype(np.float32),
        depth=(weighted / np.maximum(alpha, np.float32(1e-10))).astype(np.float32, copy=False),
        alpha=alpha,
    )


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
    from nw_splat.kernels.insert import composite as blend  # It knows numba.

    new = Image(
        rgb=np.empty_like(image.rgb),
        depth=np.empty_like(image.depth),
        alpha=np.empty_like(image.alpha),
    )
    blend(
        (image.rgb.reshape(-1, 3), image.depth.reshape(-1), image.alpha.reshape(-1)),
        (rgb.reshape(-1, 3), depth.reshape(-1), coverage.reshape(-1)),
        np.asarray(background, dtype=np.float32),
        (new.rgb.reshape(-1, 3), new.depth.reshape(-1), new.alpha.reshape(-1)),
    )
    return new


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


@dataclass(frozen=True, kw_only=True)
class CameraModel:
    """An imperfect camera. All defaults together change nothing.

    Splat colours are display values (photographs were); exposure and gain act on light, so they
    are applied between the sRGB curve's inverse and the curve. Blur and noise act on what the
    sensor reports.

    Attributes:
        exposure: stops; +1 doubles the light.
        gain: factors on red, green and blue light: white balance.
        blur: standard deviation in pixels.
        shot_noise: standard deviation at full white, falling with the square root of brightness.
        read_noise: standard deviation everywhere.
    """

    exposure: float = 0.0
    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)
    blur: float = 0.0
    shot_noise: float = 0.0
    read_noise: float = 0.0

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            UsageError: for values that are not finite, or negative where that means nothing.
        """
        for field in fields(self):
            value = getattr(self, field.name)
            values = value if isinstance(value, tuple) else (value,)
            least = -math.inf if field.name == "exposure" else 0.0
            if not all(math.isfinite(v) and v >= least for v in values):
                raise UsageError(
                    f"camera model {field.name} is {value}", fix=f"give finite numbers >= {least}"
                )

    @property
    def is_identity(self) -> bool:
        """Whether `apply` changes nothing."""
        return self == CameraModel()

    def apply(
        self, rgb: NDArray[np.float32], generator: np.random.Generator
    ) -> NDArray[np.float32]:
        """Return (H, W, 3) float32 as this camera would report it, within 0..1.

        Args:
            rgb: (H, W, 3) float32 display values.
            generator: source of the noise; drawn from only when there is noise.
        """
        if self.is_identity:
            return rgb
        out = np.clip(rgb, 0.0, 1.0)
        factors = np.asarray(self.gain, dtype=np.float32) * np.float32(2.0**self.exposure)
        if (factors != 1.0).any():
            out = _encode(np.clip(_decode(out) * factors, 0.0, 1.0).astype(np.float32))
        if self.blur > 0:
            out = _blur(_blur(out, self.blur, axis=0), self.blur, axis=1)
        if self.shot_noise > 0 or self.read_noise > 0:
            deviation = np.sqrt(self.shot_noise**2 * out + self.read_noise**2)
            out = out + deviation * generator.standard_normal(out.shape, dtype=np.float32)
        return np.clip(out, 0.0, 1.0).astype(np.float32)


def _decode(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Turn sRGB into linear light (IEC 61966-2-1)."""
    return np.where(
        values <= 0.04045, values / 12.92, same_bits.power((values + 0.055) / 1.055, 2.4)
    )


def _encode(light: NDArray[Floating]) -> NDArray[Floating]:
    """Turn linear light into sRGB."""
    return np.where(
        light <= 0.0031308, light * 12.92, 1.055 * same_bits.power(light, 1 / 2.4) - 0.055
    )


def _blur(values: NDArray[np.float32], deviation: float, *, axis: int) -> NDArray[np.float32]:
    """Gaussian along one axis; edges repeat."""
    radius = math.ceil(3 * deviation)
    offsets = np.arange(-radius, radius + 1)
    weights = same_bits.exp(-0.5 * (offsets / deviation) ** 2)
    weights /= weights.sum()
    padding = [(0, 0)] * values.ndim
    padding[axis] = (radius, radius)
    padded = np.pad(values, padding, mode="edge")
    size = values.shape[axis]
    out = np.zeros_like(values)
    for offset, weight in zip(offsets + radius, weights, strict=True):
        out += np.float32(weight) * padded.take(range(offset, offset + size), axis=axis)
    return out
