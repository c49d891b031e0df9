"""Differences between rendered images and those of any day, any lens, any sensor.

Each image of a batch gets its own draw, which all images of its stack share. Draws come from one
generator of the training's, on the CPU, so that they are the same whatever the device.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import torch
from torch import Tensor
from torch.nn import functional

if TYPE_CHECKING:
    from nw_eval.learn.student.config import Randomise

_COLOURS = 3
_LUMA = (0.299, 0.587, 0.114)
"""Weights of red, green and blue in brightness (ITU-R 601)."""
_BLUR_REACH = 2
"""Pixels on each side that a blur takes in."""
_BLURRED = 0.5
"""Share of images that are blurred at all."""


class Randomiser:
    """Changes images of a training.

    Args:
        amounts: from the config.
        generator: on the CPU.
    """

    def __init__(self, amounts: Randomise, generator: torch.Generator) -> None:
        self._amounts = amounts
        self._generator = generator

    def view(self, count: int, size: tuple[int, int]) -> Tensor:
        """Return where the pixels of images come from, (count, rows, columns, 2) for `resampled`.

        The camera is rolled, and a rectangle of its image is stretched over all of it.
        """
        rows, columns = size
        angle = self._spread(count) * math.radians(self._amounts.rotation)
        zoom = 1.0 - self._uniform(count) * self._amounts.crop
        shift = self._spread(count, 2) * (1.0 - zoom)[:, None]
        cos, sin = zoom * angle.cos(), zoom * angle.sin()
        ratio = rows / columns  # Coordinates run from -1 to 1 along both sides.
        affine = torch.stack(
            [cos, -sin * ratio, shift[:, 0], sin / ratio, cos, shift[:, 1]], dim=1
        ).reshape(count, 2, 3)
        shape = [count, 1, rows, columns]
        return functional.affine_grid(affine, shape, align_corners=False)

    def colours(self, images: Tensor) -> Tensor:
        """Return other colours, (M, 3 * frames, rows, columns), 0 to 1."""
        amount, count = self._amounts.colour, len(images)
        frames = images.unflatten(1, (-1, _COLOURS))

        def gain(*size: int) -> Tensor:
            return (1.0 + amount * self._spread(count, *size)).to(images)

        luma = torch.tensor(_LUMA).to(images)[:, None, None]
        grey = (frames * luma).sum(2, keepdim=True)
        frames = grey + gain(1, 1, 1, 1) * (frames - grey)  # Saturation.
        middle = frames.mean(dim=(1, 2, 3, 4), keepdim=True)
        frames = middle + gain(1, 1, 1, 1) * (frames - middle)  # Contrast.
        frames = frames * gain(1, 1, 1, 1) * (1.0 + 0.5 * (gain(1, _COLOURS, 1, 1) - 1.0))
        return self._blurred(frames.flatten(1, 2)).clamp(0.0, 1.0)

    def depths(self, images: Tensor) -> Tensor:
        """Return noisy depths with pixels dropped, (M, frames, rows, columns), 1 = nothing."""
        count = len(images)
        noise = torch.randn(images.shape, generator=self._generator)
        size = (count, 1, 1, 1)
        deviation = self._amounts.depth_noise * self._uniform(*size)
        share = self._amounts.dropped * self._uniform(*size)
        is_dropped = self._uniform(*images.shape) < share
        noisy = images * (1.0 + (deviation * noise).to(images))
        return noisy.masked_fill(is_dropped.to(images.device), 1.0).clamp(0.0, 1.0)

    def _blurred(self, images: Tensor) -> Tensor:
        count, channels = images.shape[:2]
        is_blurred = self._uniform(count) < _BLURRED
        sigma = (self._amounts.blur * self._uniform(count) * is_blurred).clamp(min=1e-3)
        offsets = torch.arange(-_BLUR_REACH, _BLUR_REACH + 1)
        line = torch.exp(-0.5 * (offsets / sigma[:, None]) ** 2)
        line = (line / line.sum(1, keepdim=True)).to(images)
        kernel = line.repeat_interleave(channels, 0)[:, None]
        flat = images.reshape(1, count * channels, *images.shape[2:])
        reach = _BLUR_REACH
        flat = functional.pad(flat, (reach, reach, reach, reach), mode="replicate")
        groups = count * channels
        flat = functional.conv2d(flat, kernel[:, :, :, None], groups=groups)
        flat = functional.conv2d(flat, kernel[:, :, None, :], groups=groups)
        return flat.reshape(images.shape)

    def _uniform(self, *size: int) -> Tensor:
        """Return numbers from 0 to 1."""
        return torch.rand(size, generator=self._generator)

    def _spread(self, *size: int) -> Tensor:
        """Return numbers from -1 to 1."""
        return 2.0 * self._uniform(*size) - 1.0


def resampled(images: Tensor, view: Tensor) -> Tensor:
    """Return images as another camera would have them: between pixels, and edges go on."""
    return functional.grid_sample(
        images, view.to(images), mode="bilinear", padding_mode="border", align_corners=False
    )
