"""Wrappers of images: (H, W) numbers or (H, W, C) colours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards.observations import wraps
from nw_eval.errors import PolicyError
from nw_eval.sensors.wrappers.link import Plain, Sample, Shot
from nw_eval.sensors.wrappers.values import rounded

# ITU-R BT.601, as OpenCV and Pillow reckon brightness.
_LUMA = np.array([0.299, 0.587, 0.114])
_FLAT, _COLOUR = 2, 3


class Crop(Plain):
    """Fewer rows and columns."""

    def __init__(self, wrap: wraps.Crop) -> None:
        self._wrap = wrap

    def __call__(self, sample: Sample, shot: Shot) -> Sample:  # noqa: ARG002 - as every wrapper.
        """Return the inner part."""
        height, width = _size(sample, "crop")
        wrap = self._wrap
        if wrap.top + wrap.bottom >= height or wrap.left + wrap.right >= width:
            raise PolicyError(f"crop leaves nothing of {height} x {width}", fix="cut less off")
        inner = sample[wrap.top : height - wrap.bottom, wrap.left : width - wrap.right]
        return np.ascontiguousarray(inner)


class Resize(Plain):
    """Another size: each axis by a matrix of weights."""

    def __init__(self, wrap: wraps.Resize) -> None:
        self._wrap = wrap
        self._weights: dict[tuple[int, int], NDArray[np.float64]] = {}

    def __call__(self, sample: Sample, shot: Shot) -> Sample:  # noqa: ARG002 - as every wrapper.
        """Return (height, width) of the card, with the sample's own type."""
        height, width = _size(sample, "resize")
        wrap = self._wrap
        if wrap.method == "nearest":
            rows, columns = _centres(height, wrap.height), _centres(width, wrap.width)
            return sample[rows.astype(np.intp)][:, columns.astype(np.intp)]
        down, across = self._matrix(height, wrap.height), self._matrix(width, wrap.width)
        planes = sample.reshape(height, width, -1).astype(np.float64)
        resized = np.einsum("hi,wj,ijc->hwc", down, across, planes, optimize=True)
        shape = (wrap.height, wrap.width, *sample.shape[2:])
        return rounded(resized.reshape(shape), sample.dtype)

    def _matrix(self, old: int, new: int) -> NDArray[np.float64]:
        if (old, new) not in self._weights:
            area = self._wrap.method == "area"
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

    def __init__(self, wrap: wraps.Channels) -> None:
        self._wrap = wrap

    def __call__(self, sample: Sample, shot: Shot) -> Sample:  # noqa: ARG002 - as every wrapper.
        """Return (C, H, W) or (H, W, C)."""
        _size(sample, "channels")
        if sample.ndim == _FLAT:
            sample = np.repeat(sample[..., np.newaxis], self._wrap.repeat, axis=-1)
        elif self._wrap.repeat > 1:
            raise PolicyError(
                f"channels cannot repeat the colours of {sample.shape}", fix="drop `repeat`"
            )
        return np.ascontiguousarray(
            np.moveaxis(sample, -1, 0) if self._wrap.axis == "first" else sample
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
