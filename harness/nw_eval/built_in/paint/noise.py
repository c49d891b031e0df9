"""Seeded noise made of exact arithmetic only, so that it is the same on every machine."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Seeds = NDArray[np.uint32] | int

_SCALE = 1.0 / 4294967296.0


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
