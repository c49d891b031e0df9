"""Filtered patterns: what a soft-edged spot sees of lines, tiles and rectangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_eval.built_in.paint.noise import Array, Seeds, hashed


def pulse(x: Array, period: Array | float, width: Array | float, blur: Array) -> Array:
    """Return how much of a spot of size `blur` lies on lines.

    The lines cover [0, `width`] in each `period`; all in metres.
    """

    def area(at: Array) -> Array:
        turns = np.floor(at / period)
        return turns * width + np.minimum(at - turns * period, width)

    size = np.maximum(blur, 1e-4)
    return (area(x + 0.5 * size) - area(x - 0.5 * size)) / size


def step(x: Array, edge: Array | float, blur: Array) -> Array:
    """Return how much of a spot at `x` lies beyond `edge`, 0 to 1."""
    return np.clip((x - edge) / np.maximum(blur, 1e-4) + 0.5, 0.0, 1.0)


def band(x: Array, low: Array | float, high: Array | float, blur: Array) -> Array:
    """Return how much of a spot at `x` lies between two edges."""
    return step(x, low, blur) * (1.0 - step(x, high, blur))


def frame(u: Array, v: Array, w: Array, h: Array, width: Array | float, blur: Array) -> Array:
    """Return how much of a spot lies on the rim of the rectangle 0..w, 0..h."""
    inside = band(u, width, w - width, blur) * band(v, width, h - width, blur)
    return 1.0 - inside


@dataclass(frozen=True, kw_only=True)
class Tiles:
    """What spots see of a tiling.

    Attributes:
        joint: (N,) how much of the spot lies in joints.
        shade: (N,) a number in [-1, 1] for each tile, faded where tiles are too small to see.
        column, row: (N,) int64 indices of the tile.
        u, v: (N,) metres from the tile's corner.
    """

    joint: Array
    shade: Array
    column: NDArray[np.int64]
    row: NDArray[np.int64]
    u: Array
    v: Array


def tiles(
    u: Array,
    v: Array,
    *,
    size: tuple[float, float],
    joint: float,
    blur: Array,
    seed: Seeds,
    shift: float = 0.0,
    loose: bool = False,
) -> Tiles:
    """Lay tiles of `size` metres with joints between them.

    Args:
        u: (N,) metres along the rows.
        v: (N,) metres across the rows.
        size: metres from tile to tile, along and across.
        joint: metres between tiles.
        blur: (N,) size of the spots, metres.
        seed: tells one tiling from another.
        shift: share of a tile by which each row is moved against the one below; 0.5 for bricks.
        loose: moves each row by a random share instead, as floor boards are laid.
    """
    row = np.floor(v / size[1]).astype(np.int64)
    moved = u + hashed(seed, row, 77) * size[0] if loose else u + row * (shift * size[0])
    column = np.floor(moved / size[0]).astype(np.int64)
    across = pulse(moved + joint / 2, size[0], joint, blur)
    along = pulse(v + joint / 2, size[1], joint, blur)
    seen = np.clip(1.5 - blur / min(size), 0.15, 1.0)
    return Tiles(
        joint=1.0 - (1.0 - across) * (1.0 - along),
        shade=(2.0 * hashed(seed, column, row) - 1.0) * seen,
        column=column,
        row=row,
        u=moved - column * size[0],
        v=v - row * size[1],
    )
