"""Wrappers that change numbers one by one."""

from __future__ import annotations

import numpy as np

from nw_eval.cards.observations import wrappers
from nw_eval.errors import PolicyError
from nw_eval.sensors.wrappers.wrapper import Plain, Sample, Shot

_BYTE = 255


class AddNoise(Plain):
    """Gaussian errors and lost numbers; a lost pixel of a colour image loses all its colours.

    Args:
        noise: from the card.
        nothing: what a lost number reads unless the card says it.
    """

    def __init__(self, noise: wrappers.Noise, nothing: float = 0.0) -> None:
        self._noise = noise
        lost = nothing if noise.lost is None else noise.lost
        self._lost = np.nan if lost == "nan" else lost

    def __call__(self, sample: Sample, shot: Shot) -> Sample:
        """Draw errors from the trial's stream."""
        noise, rng = self._noise, shot.rng
        values = sample.astype(np.float64)
        if noise.proportional:
            values *= 1.0 + noise.proportional * rng.standard_normal(values.shape)
        if noise.gaussian:
            values += noise.gaussian * rng.standard_normal(values.shape)
        if noise.dropout:
            shape = values.shape[:-1] if is_colour(sample) else values.shape
            values[rng.random(shape) < noise.dropout] = self._lost
        return rounded(values, sample.dtype)


class Normalize(Plain):
    """(value - mean) / std."""

    def __init__(self, settings: wrappers.Normalize) -> None:
        self._mean = np.asarray(settings.mean, dtype=np.float32)
        self._std = np.asarray(settings.std, dtype=np.float32)

    def __call__(self, sample: Sample, shot: Shot) -> Sample:  # noqa: ARG002 - as every wrapper.
        """Return float32."""
        for values in (self._mean, self._std):
            if values.ndim and (not sample.ndim or sample.shape[-1] != values.size):
                raise PolicyError(
                    f"normalize has {values.size} numbers for a sample of shape {sample.shape}",
                    fix="give one, or one for each number along the last axis",
                )
        return (sample.astype(np.float32) - self._mean) / self._std


class Scale(Plain):
    """value * scale + offset."""

    def __init__(self, settings: wrappers.Scale) -> None:
        self._scale, self._offset = np.float32(settings.scale), np.float32(settings.offset)

    def __call__(self, sample: Sample, shot: Shot) -> Sample:  # noqa: ARG002 - as every wrapper.
        """Return float32."""
        return sample.astype(np.float32) * self._scale + self._offset


class Clip(Plain):
    """Limits, and something for NaN."""

    def __init__(self, settings: wrappers.Clip) -> None:
        self._limits = settings.limits
        self._nan = settings.nan

    def __call__(self, sample: Sample, shot: Shot) -> Sample:  # noqa: ARG002 - as every wrapper.
        """Return the sample's own type."""
        limited = np.clip(sample, *self._limits)
        if self._nan is not None:
            limited = np.where(np.isnan(limited), self._nan, limited)
        return limited.astype(sample.dtype)


class Quantize(Plain):
    """Multiples of a step, halves to the even one."""

    def __init__(self, settings: wrappers.Quantize) -> None:
        self._step = settings.step

    def __call__(self, sample: Sample, shot: Shot) -> Sample:  # noqa: ARG002 - as every wrapper.
        """Return the sample's own type."""
        values = np.rint(sample.astype(np.float64) / self._step) * self._step
        return rounded(values, sample.dtype)


class Flatten(Plain):
    """One row of numbers."""

    def __call__(self, sample: Sample, shot: Shot) -> Sample:  # noqa: ARG002 - as every wrapper.
        """Return (n,)."""
        return sample.reshape(-1)


def is_colour(sample: Sample) -> bool:
    """Whether the last axis holds the colours of pixels or the coordinates of points."""
    return sample.ndim >= 3 and sample.shape[-1] == 3


def rounded(values: np.ndarray, dtype: np.dtype) -> Sample:
    """Return values as another type: bytes are rounded and limited, not wrapped around."""
    if dtype == np.uint8:
        values = np.clip(np.rint(values), 0, _BYTE)
    return values.astype(dtype)
