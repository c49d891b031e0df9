"""What a material is asked about, what it answers, and what it is made of: noise and patterns.

Noise is seeded and made of exact arithmetic only, so that it is the same on every machine. Patterns
are filtered: what a soft-edged spot sees of lines, tiles and rectangles.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_base import same_bits
from nw_places.places.parts import Light

Array = NDArray[np.float64]
Seeds = NDArray[np.uint32] | int

_SCALE = 1.0 / 4294967296.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Spots:
    """N places on surfaces of one material.

    Attributes:
        p: (N, 3) metres, world.
        n: (N, 3) outward unit normals.
        u, v: (N,) texture coordinates, metres; patterns run on from patch to patch.
        s, t: (N,) metres from the corner of the patch or decal.
        w, h: (N,) width and height of the patch or decal, metres.
        blur: (N,) metres over which colour is averaged.
        seed: (N,) uint32, differs from patch to patch.
        light: what shines outside, for windows.
    """

    p: Array
    n: Array
    u: Array
    v: Array
    s: Array
    t: Array
    w: Array
    h: Array
    blur: Array
    seed: NDArray[np.uint32]
    light: Light

    @property
    def uv(self) -> Array:
        """(N, 2) metres on the patch."""
        return np.stack([self.u, self.v], axis=1)

    def __len__(self) -> int:
        return len(self.u)


@dataclass(frozen=True, kw_only=True, eq=False)
class Coat:
    """How spots look.

    Attributes:
        albedo: (N, 3) share of light sent back, linear.
        glow: (N, 3) radiance of their own, linear; None for none.
    """

    albedo: Array
    glow: Array | None = None


Colour = Array
Material = Callable[[Spots, Colour], Coat]


def linear(code: str) -> Colour:
    """Return the linear (3,) colour of `#rrggbb`."""
    display = np.array([int(code[i : i + 2], 16) / 255.0 for i in (1, 3, 5)])
    return np.where(
        display <= 0.04045, display / 12.92, same_bits.power((display + 0.055) / 1.055, 2.4)
    )


def blend(base: Array, over: Array, share: NDArray[np.floating]) -> Array:
    """Return (N, 3) of `base` with `share` (N,) of `over` on it; both (N, 3) or (3,)."""
    return base + (over - base) * share[:, None]


def flat(spots: Spots, colour: Colour) -> Array:
    """Return the colour once for each spot, (N, 3)."""
    return np.broadcast_to(colour, (len(spots), 3)).copy()


def tint(colour: Array, shade: NDArray[np.floating]) -> Array:
    """Return (N, 3): the colour made lighter or darker by `shade` (N,), 0 for as it is."""
    return colour * np.maximum(1.0 + shade, 0.02)[:, None]


def grain(spots: Spots, salt: int) -> Array:
    """Return one number in [-1, 1] for each spot, from where it is; fainter for large spots."""
    cell = np.floor(spots.p / 0.004).astype(np.int64)
    fade = np.clip(1.6 - spots.blur / 0.05, 0.25, 1.0)
    return fade * (2.0 * hashed(salt, cell[:, 0], cell[:, 1], cell[:, 2]) - 1.0)


def rim(spots: Spots, width: float) -> Array:
    """Return 1 at the rim of the patch, falling to 0 at `width` metres from it."""
    near = np.minimum(
        np.minimum(spots.s, spots.w - spots.s), np.minimum(spots.t, spots.h - spots.t)
    )
    return np.clip(1.0 - near / width, 0.0, 1.0)


def hashed(*keys: NDArray[np.integer] | Seeds) -> Array:
    """Return a uniform number in [0, 1) for each combination of integer keys, elementwise."""
    state = np.array([0x9E3779B9], dtype=np.uint32)
    for key in keys:
        part = np.atleast_1d(key)
        # Negative lattice indices wrap round, as two's complement does.
        part = (part.astype(np.int64) & 0xFFFFFFFF).astype(np.uint32)
        state = np.bitwise_xor(part, state) * np.uint32(0x85EBCA6B)
        state = (state ^ (state >> np.uint32(13))) * np.uint32(0xC2B2AE35)
        state = state ^ (state >> np.uint32(16))
    return np.asarray(state, dtype=np.float64) * _SCALE


def noise(points: Array, wavelength: float | Array, seed: Seeds) -> Array:
    """Return smooth noise in [-1, 1].

    Args:
        points: (N, 2) or (N, 3) metres.
        wavelength: metres from bump to bump; one, or (N, D) for bumps that are stretched.
        seed: tells one field from another.
    """
    scaled = points / wavelength
    base = np.floor(scaled)
    part = scaled - base
    weight = part * part * (3.0 - 2.0 * part)
    lattice = base.astype(np.int64)
    dimensions = points.shape[1]
    total = np.zeros(len(points))
    for corner in range(1 << dimensions):
        bits = [(corner >> axis) & 1 for axis in range(dimensions)]
        value = hashed(seed, *(lattice[:, axis] + bits[axis] for axis in range(dimensions)))
        for axis in range(dimensions):
            value = value * (weight[:, axis] if bits[axis] else 1.0 - weight[:, axis])
        total += value
    return 2.0 * total - 1.0


def fractal(
    points: Array, wavelength: float, seed: Seeds, *, octaves: int = 4, blur: Array | float = 0.0
) -> Array:
    """Return a sum of octaves of `noise`, each half as long and 0.55 times as strong.

    Octaves that are too short to be told apart at a spot's `blur` (metres) fade out.
    """
    total = np.zeros(len(points))
    strength = 1.0
    norm = 0.0
    for octave in range(octaves):
        length = wavelength / (1 << octave)
        seen = np.clip(2.0 - 2.0 * np.asarray(blur) / length, 0.0, 1.0)
        norm += strength
        if np.any(seen > 0.0):
            # Each octave is moved, so that lattice points do not lie on top of each other.
            moved = points + 17.31 * (octave + 1)
            total += strength * seen * noise(moved, length, np.asarray(seed) + 101 * octave)
        strength *= 0.55
    return total / norm


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
