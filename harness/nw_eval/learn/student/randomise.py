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
        count = len(images)
        luma = torch.tensor(_LUMA).expand(_COLOURS, _COLOURS)
        saturation, contrast, brightness = (self._gain(count, 1, 1) for _ in range(3))
        mixed = luma + saturation * (torch.eye(_COLOURS) - luma)
        tint = 1.0 + 0.5 * (self._gain(count, _COLOURS, 1) - 1.0)
        # All of it is one matrix for each image, and contrast a shift by what the mean loses.
        matrix = (tint * brightness * contrast * mixed).to(images)
        frames = images.unflatten(1, (-1, _COLOURS)).flatten(3)
        middle = frames.mean(dim=(1, 2, 3)).cpu()[:, None, None]
        shift = (tint * brightness * (1.0 - contrast) * middle).to(images)
        changed = torch.matmul(matrix[:, None], frames) + shift[:, None]
        return self._blurred(changed.reshape(images.shape)).clamp_(0.0, 1.0)

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
        """Return images of which some are blurred, by a Gaussian of three pixels each way."""
        sigma = (self._amounts.blur * self._uniform(len(images))).clamp(min=1e-3)
        chosen = (self._uniform(len(images)) < _BLURRED).nonzero()[:, 0]
        beside = torch.exp(-0.5 / sigma[chosen] ** 2)
        middle = 1.0 / (1.0 + 2.0 * beside)
        own, others = (x.to(images)[:, None, None, None] for x in (middle, middle * beside))
        chosen = chosen.to(images.device)
        some = images[chosen]
        for axis in (2, 3):
            size = some.shape[axis]
            around, some = others * some, own * some
            some.narrow(axis, 1, size - 1).add_(around.narrow(axis, 0, size - 1))
            some.narrow(axis, 0, size - 1).add_(around.narrow(axis, 1, size - 1))
            for edge in (0, size - 1):  # They go on.
                some.narrow(axis, edge, 1).add_(around.narrow(axis, edge, 1))
        return images.index_copy(0, chosen, some)

    def _gain(self, *size: int) -> Tensor:
        """Return factors around 1."""
        return 1.0 + self._amounts.colour * self._spread(*size)

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
