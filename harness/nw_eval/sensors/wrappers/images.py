"""Wrappers of images: (H, W) numbers or (H, W, C) colours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards.observations import wrappers
from nw_eval.errors import PolicyError
from nw_eval.sensors.wrappers.values import rounded
from nw_eval.sensors.wrappers.wrapper import Plain, Sample, Shot

# ITU-R BT.601, as OpenCV and Pillow reckon brightness.
_LUMA = np.array([0.299, 0.587, 0.114])
_FLAT, _COLOUR = 2, 3


class Crop(Plain):
    """Fewer rows and columns."""

    def __init__(self, settings: wrappers.Crop) -> None:
        self._settings = settings

    def __call__(self, sample: Sample, shot: Shot) -> Sample:  # noqa: ARG002 - as every wrapper.
        """Return the inner part."""
        height, width = _size(sample, "crop")
        settings = self._settings
        if settings.top + settings.bottom >= height or settings.left + settings.right >= width:
            raise PolicyError(f"crop leaves nothing of {height} x {width}", fix="cut less off")
        rows = slice(settings.top, height - settings.bottom)
        columns = slice(settings.left, width - settings.right)
        return np.ascontiguousarray(sample[rows, columns])


class Resize(Plain):
    """Another size: each axis by a matrix of weights."""

    def __init__(self, settings: wrappers.Resize) -> None:
        self._settings = settings
        self._weights: dict[tuple[int, int], NDArray[np.float64]] = {}

    def __call__(self, sample: Sample, shot: Shot) -> Sample:  # noqa: ARG002 - as every wrapper.
        """Return (height, width) of the card, with the sample's own type."""
        height, width = _size(sample, "resize")
        settings = self._settings
        if settings.method == "nearest":
            rows, columns = _centres(height, settings.height), _centres(width, settings.width)
            return sample[rows.astype(np.intp)][:, columns.astype(np.intp)]
        down, across = self._matrix(height, settings.height), self._matrix(width, settings.width)
        planes = sample.reshape(height, width, -1).astype(np.float64)
        resized = np.einsum("hi,wj,ijc->hwc", down, across, planes, optimize=True)
        shape = (settings.height, settings.width, *sample.shape[2:])
        return rounded(resized.reshape(shape), sample.dtype)

    def _matrix(self, old: int, new: int) -> NDArray[np.float64]:
        if (old, new) not in self._weights:
            area = self._settings.method == "area"
            self._weights[old, new] = _area(old, new) if area else _bilinear(old, new)
        return self._weights[old, new]


class Grayscale(Plain):
    """Brightness."""

    def __call__(self, sample: Sample, shot: Shot) -> Sample:  # noqa: ARG002 - as every wrapper.
        """Return (H, W) of the sample's own type."""
        if sample.ndim != _COLOUR or sample.shape[-1] != len(_LUMA):
            raise PolicyError(
                f"grayscale takes (H, W, 3), not {sample.shape}",
                fix="put it before `channels` and `stack`",
            )
        return rounded(sample @ _LUMA, sample.dtype)


class Channels(Plain):
    """Colours first or last."""

    def __init__(self, settings: wrappers.Channels) -> None:
        self._settings = settings

    def __call__(self, sample: Sample, shot: Shot) -> Sample:  # noqa: ARG002 - as every wrapper.
        """Return (C, H, W) or (H, W, C)."""
        _size(sample, "channels")
        if sample.ndim == _FLAT:
            sample = np.repeat(sample[..., np.newaxis], self._settings.repeat, axis=-1)
        elif self._settings.repeat > 1:
            raise PolicyError(
                f"channels cannot repeat the colours of {sample.shape}", fix="drop `repeat`"
            )
        return np.ascontiguousarray(
            np.moveaxis(sample, -1, 0) if self._settings.axis == "first" else sample
        )


def _size(sample: Sample, wrapper: str) -> tuple[int, int]:
    if sample.ndim not in {_FLAT, _COLOUR}:
        raise PolicyError(
            f"{wrapper} takes an image (H, W) or (H, W, C), not {sample.shape}",
            fix=f"put {wrapper} before `stack` and `flatten`",
        )
    return sample.shape[0], sample.shape[1]


def _centres(old: int, new: int) -> NDArray[np.float64]:
    """Return where the centres of new pixels lie, in old pixels from the left border."""
    return (np.arange(new, dtype=np.float64) + 0.5) * (old / new)


def _area(old: int, new: int) -> NDArray[np.float64]:
    """Return the share (new, old) that each old pixel has of each new one."""
    borders = np.arange(new + 1, dtype=np.float64) * (old / new)
    left = np.maximum(borders[:-1, np.newaxis], np.arange(old))
    right = np.minimum(borders[1:, np.newaxis], np.arange(1, old + 1))
    return np.maximum(right - left, 0.0) * (new / old)


def _bilinear(old: int, new: int) -> NDArray[np.float64]:
    """Return the weights (new, old) of the two old pixels around each new centre."""
    place = np.clip(_centres(old, new) - 0.5, 0.0, old - 1.0)
    lower = np.minimum(place.astype(np.intp), max(old - 2, 0))
    share = place - lower
    weights = np.zeros((new, old))
    rows = np.arange(new)
    weights[rows, lower] += 1.0 - share
    weights[rows, np.minimum(lower + 1, old - 1)] += share
    return weights
