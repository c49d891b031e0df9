"""Leaves and blades of grass: Gaussians that are not on any surface."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from nw_base import same_bits
from nw_places.bake.materials import colour_of
from nw_places.bake.spots import Array, fractal, linear
from nw_places.bake.surfels import eye_distance, length
from nw_places.places.parts import Crown, Lawn
from nw_scenes.scene import Vector

# A leaf is about this many metres wide for each metre between it and the eye's path.
_ANGLE = 0.021
# Leaves per square of their size, and most leaves of a scene.
_DENSITY = 1.1
_BUDGET = 45_000


@dataclass(frozen=True, kw_only=True, eq=False)
class Tufts:
    """N Gaussians with what is needed to light them.

    Attributes:
        means, scales: (N, 3) metres.
        quats: (N, 4) w x y z.
        albedo: (N, 3).
        opacity: (N,).
        lit_at, normals: (N, 3) where and which way light is asked for.
        shade: (N,) factor on that light: leaves deep in a crown are dark.
        glow_through: (N,) share of the sun that shines through from behind.
    """

    means: Array
    scales: Array
    quats: Array
    albedo: Array
    opacity: Array
    lit_at: Array
    normals: Array
    shade: Array
    glow_through: Array


def leaves(
    crowns: Sequence[Crown], eyes: Sequence[Vector], coarseness: float, rng: np.random.Generator
) -> list[Tufts]:
    """Return the leaves of crowns: ragged clusters, and a dark core that nothing shines through.

    Their number is kept to a budget: in a wood, leaves are larger.
    """
    sizes = np.array([_leaf_size(crown, eyes, coarseness) for crown in crowns])
    areas = np.array([_area(crown) for crown in crowns])
    sizes *= max(1.0, float(np.sqrt((_DENSITY * areas / sizes**2).sum() / _BUDGET)))
    counts = np.maximum(_DENSITY * areas / sizes**2, 60.0).astype(np.int64)
    return [
        _together(_shell(crown, float(size), int(count), rng), _core(crown, rng))
        for crown, size, count in zip(crowns, sizes, counts, strict=True)
    ]


def _leaf_size(crown: Crown, eyes: Sequence[Vector], coarseness: float) -> float:
    reach = min(crown.radii)
    near = max(float(eye_distance(np.array([crown.center]), eyes)[0]) - reach, 0.4)
    size = min(max(_ANGLE * near, 0.020), 0.5) * coarseness * crown.fine
    return min(size, 0.16 * reach)


def _area(crown: Crown) -> float:
    """Return about the surface of an ellipsoid (Knud Thomsen's formula with exponent 1.6)."""
    a, b, c = crown.radii
    mean = ((a * b) ** 1.6 + (a * c) ** 1.6 + (b * c) ** 1.6) / 3.0
    return 4.0 * math.pi * mean ** (1.0 / 1.6)


def _shell(
    crown: Crown,
    size: float,
    count: int,
    rng: np.random.Generator,
) -> Tufts:
    center, radii = np.array(crown.center), np.array(crown.radii)
    reach = min(crown.radii)
    out = _sphere(count, rng)
    # Twigs carry the leaves: the surface bulges and gapes in lumps of several sizes.
    surface = center + out * radii
    lumps = fractal(surface, 0.75 * reach, 801, octaves=4)
    depth = 0.98 - 0.26 * same_bits.power(rng.random(count), 1.5) + 0.30 * lumps
    means = center + out * radii * depth[:, None] + size * 0.4 * rng.standard_normal((count, 3))
    normals = out / radii
    normals = normals / length(normals)[:, None]
    tilt = normals + 0.7 * rng.standard_normal((count, 3))
    tilt = tilt / length(tilt)[:, None]
    wide = 0.50 * size * (0.65 + 0.7 * rng.random(count))
    scales = np.stack([wide, wide * (0.45 + 0.3 * rng.random(count)), wide * 0.2], axis=1)
    base = colour_of(crown.material)
    clumps = fractal(means, 0.5 * reach, 803, octaves=3)
    hue = rng.standard_normal(count)
    albedo = base * np.maximum(1.05 + 0.35 * clumps + 0.28 * hue, 0.15)[:, None]
    pale = np.clip(0.12 + 0.13 * hue + 0.2 * clumps, 0.0, 0.5)[:, None]
    albedo = albedo + (linear("#a8a447") - albedo) * pale
    shade = np.clip(0.55 + 1.9 * (depth - 0.86), 0.12, 1.15)
    return Tufts(
        means=means,
        scales=scales,
        quats=quats_from_normals(tilt, 2 * np.pi * rng.random(count)),
        albedo=albedo,
        opacity=np.full(count, 0.93),
        lit_at=center + out * radii * 1.06,
        normals=normals,
        shade=shade,
        glow_through=0.16 * shade,
    )


def _core(crown: Crown, rng: np.random.Generator) -> Tufts:
    center, radii = np.array(crown.center), np.array(crown.radii)
    count = min(max(int(0.35 * _area(crown) / (0.15 * min(crown.radii)) ** 2), 40), 120)
    out = _sphere(count, rng)
    normals = out / radii
    return Tufts(
        means=center + out * radii * (0.48 + 0.12 * rng.random(count))[:, None],
        scales=np.broadcast_to(0.135 * radii, (count, 3)).copy(),
        quats=np.broadcast_to([1.0, 0.0, 0.0, 0.0], (count, 4)).copy(),
        albedo=np.broadcast_to(colour_of(crown.material) * 0.5, (count, 3)).copy(),
        opacity=np.full(count, 0.97),
        lit_at=center + out * radii * 1.06,
        normals=normals / length(normals)[:, None],
        shade=np.full(count, 0.35),
        glow_through=np.zeros(count),
    )


def _sphere(count: int, rng: np.random.Generator) -> Array:
    """Return random unit vectors, (N, 3)."""
    z = 1.0 - 2.0 * rng.random(count)
    turn = 2.0 * np.pi * rng.random(count)
    ring = np.sqrt(1.0 - z * z)
    return np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1)


def _together(one: Tufts, two: Tufts) -> Tufts:
    return Tufts(
        **{
            field.name: np.concatenate([getattr(one, field.name), getattr(two, field.name)])
            for field in fields(Tufts)
        }
    )


def blades(
    lawn: Lawn,
    positions: Array,
    sizes: Array,
    rng: np.random.Generator,
) -> Tufts:
    """Return blades of grass at positions (N, 3) on cells of `sizes` (N,), metres."""
    total = len(positions)
    means = positions.copy()
    means[:, :2] += (rng.random((total, 2)) - 0.5) * sizes[:, None]
    patches = fractal(means[:, :2], 2.6, 91, octaves=4)
    tall = lawn.height * (0.75 + 0.7 * rng.random(total)) * (1.0 + 0.3 * patches)
    wide = np.maximum(0.17 * sizes, 0.0022)
    wide = np.where(sizes > 0.07, 0.42 * sizes, wide)
    means[:, 2] = 0.42 * tall
    lean = 0.45 * rng.standard_normal((total, 2))
    lean = np.where((sizes > 0.07)[:, None], 0.3 * lean, lean)
    stem = np.concatenate([lean, np.ones((total, 1))], axis=1)
    stem = stem / length(stem)[:, None]
    scales = np.stack([wide, wide * 0.6, 0.48 * tall], axis=1)
    base = colour_of(lawn.material)
    hue = rng.standard_normal(total)
    dry = np.clip(fractal(means[:, :2], 1.1, 95, octaves=4) - 0.12, 0.0, 1.0)
    albedo = base * np.maximum(1.25 + 0.30 * hue + 0.25 * patches, 0.3)[:, None]
    straw = linear("#b5ab62")
    pale = np.clip(0.10 + 0.8 * dry + 0.12 * hue, 0.0, 0.75)
    albedo = albedo + (straw - albedo) * pale[:, None]
    up = np.zeros((total, 3))
    up[:, 2] = 1.0
    lit = means.copy()
    lit[:, 2] = 0.05
    return Tufts(
        means=means,
        scales=scales,
        quats=quats_from_normals(stem, 2 * np.pi * rng.random(total)),
        albedo=albedo,
        opacity=np.full(total, 0.92),
        lit_at=lit,
        normals=up,
        shade=0.85 + 0.25 * rng.random(total),
        glow_through=np.full(total, 0.10),
    )


def quats_from_normals(normals: Array, spin: Array) -> Array:
    """Return w x y z rotations, (N, 4), that spin (N,) radians about +z, then turn +z to normals.

    Args:
        normals: (N, 3) unit vectors; +z goes there by the shortest turn, to -z about +x.
        spin: (N,) radians.
    """
    x, y, z = normals.T
    ring = np.sqrt(x * x + y * y)
    # The axis is z x n, and half the turn's tangent is ring / (1 + z) or (1 - z) / ring: each is
    # sound on its own side, where it takes no difference of near numbers.
    far = 1.0 + np.abs(z)
    down = z < 0.0
    w, turn = np.where(down, ring, far), np.where(down, far, ring)
    pole = ring == 0.0
    size = np.where(pole, 1.0, ring)
    axis_x, axis_y = np.where(pole, 1.0, -y / size), x / size
    cosine, sine = np.cos(spin / 2), np.sin(spin / 2)
    q = np.stack(
        [
            w * cosine,
            turn * (axis_x * cosine + axis_y * sine),
            turn * (axis_y * cosine - axis_x * sine),
            w * sine,
        ],
        axis=1,
    )
    return q / np.sqrt((q * q).sum(axis=1))[:, None]
