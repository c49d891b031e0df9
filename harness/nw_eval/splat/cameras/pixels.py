"""Which pixels of a view are rendered."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import UsageError

Scalar = TypeVar("Scalar", bound=np.generic)


@dataclass(frozen=True, kw_only=True)
class Pixels:
    """A block of pixels out of every stride x stride cell of an image.

    The published 80x45 image of a 1280x720 view reads the 2x2 block at (7, 7) of every 16x16 cell
    (an OpenCV bilinear resize by 16 without antialias): `Pixels(stride=16, block=2, offset=7)`
    renders those 14,400 pixels and no others. Columns and rows beyond the last whole cell are
    dropped.

    Attributes:
        stride: cell side in pixels.
        block: pixels taken along each side of a cell.
        offset: the first pixel taken within a cell, along both axes.
    """

    stride: int = 1
    block: int = 1
    offset: int = 0

    def __post_init__(self) -> None:
        """Check that the block lies within its cell.

        Raises:
            UsageError: when it does not.
        """
        if self.stride < 1 or self.block < 1 or self.offset < 0:
            raise UsageError(
                f"{self} is not a pixel set", fix="give stride, block >= 1, offset >= 0"
            )
        if self.offset + self.block > self.stride:
            raise UsageError(f"{self} reaches beyond its cell", fix="keep offset + block <= stride")

    def count(self, side: int) -> int:
        """Number of pixels taken along an image side of `side` pixels."""
        return side // self.stride * self.block

    def indices(self, side: int) -> NDArray[np.int64]:
        """(count,) pixel indices taken along an image side of `side` pixels."""
        cells = np.arange(side // self.stride)[:, None] * self.stride
        return (cells + self.offset + np.arange(self.block)).reshape(-1)

    def index(self, number: int) -> int:
        """Pixel index of the number-th pixel taken along a side."""
        cell, within = divmod(number, self.block)
        return cell * self.stride + self.offset + within

    def crop(self, image: NDArray[Scalar]) -> NDArray[Scalar]:
        """Return the pixels of a full image (H, W, ...): (H', W', ...)."""
        rows, columns = self.indices(image.shape[0]), self.indices(image.shape[1])
        return image[rows][:, columns]

    def mean(self, image: NDArray[Any]) -> NDArray[Any]:
        """Average each block of an image rendered with this set: (H'/block, W'/block, ...)."""
        b = self.block
        h, w = image.shape[0] // b, image.shape[1] // b
        return image.reshape(h, b, w, b, *image.shape[2:]).mean(axis=(1, 3))
