"""What a real camera does to a picture: exposure, gain, blur and noise."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import UsageError


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
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def _encode(light: NDArray[np.float32]) -> NDArray[np.float32]:
    """Turn linear light into sRGB."""
    return np.where(light <= 0.0031308, light * 12.92, 1.055 * light ** (1 / 2.4) - 0.055)


def _blur(values: NDArray[np.float32], deviation: float, *, axis: int) -> NDArray[np.float32]:
    """Gaussian along one axis; edges repeat."""
    radius = math.ceil(3 * deviation)
    offsets = np.arange(-radius, radius + 1)
    weights = np.exp(-0.5 * (offsets / deviation) ** 2)
    weights /= weights.sum()
    padding = [(0, 0)] * values.ndim
    padding[axis] = (radius, radius)
    padded = np.pad(values, padding, mode="edge")
    size = values.shape[axis]
    out = np.zeros_like(values)
    for offset, weight in zip(offsets + radius, weights, strict=True):
        out += np.float32(weight) * padded.take(range(offset, offset + size), axis=axis)
    return out
