"""What a material is asked about, and what it answers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_eval.built_in.paint.noise import Array, hashed
from nw_eval.built_in.places.parts import Light


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
    return np.where(display <= 0.04045, display / 12.92, ((display + 0.055) / 1.055) ** 2.4)


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
