"""The sky: what a ray that meets nothing sees, and the dome of Gaussians that shows it."""

from __future__ import annotations

import math

import numpy as np

from nw_eval.built_in.bake.surfels import dot
from nw_eval.built_in.paint.noise import Array, fractal
from nw_eval.built_in.places.parts import Light


def sun_direction(light: Light) -> Array:
    """Return the unit vector to the sun, (3,)."""
    sun = np.array(light.sun)
    return sun / math.sqrt(float(sun[0] ** 2 + sun[1] ** 2 + sun[2] ** 2))


def sky_radiance(directions: Array, light: Light, *, clouds: bool) -> Array:
    """Return what unit directions (N, 3) see of the sky, (N, 3) linear.

    Args:
        directions: (N, 3) unit vectors.
        light: the sky's colours.
        clouds: draws single clouds; light that is gathered needs only their mean.
    """
    up = np.clip(directions[:, 2], 0.0, 1.0)
    zenith, horizon = np.array(light.zenith), np.array(light.horizon)
    high = np.sqrt(up)
    colour = horizon + (zenith - horizon) * high[:, None]
    toward = np.clip(dot(directions, sun_direction(light)), 0.0, 1.0)
    halo = 0.25 * toward**8 + 0.10 * toward**2
    colour = colour + halo[:, None] * np.array(light.sun_colour) * 0.5
    white = 0.55 * horizon + 0.35 * np.array(light.sun_colour) + 0.15 * zenith
    if clouds and light.clouds > 0:
        flat = directions[:, :2] / (up + 0.16)[:, None]
        shape = fractal(flat + 3.7, 1.1, 601, octaves=6)
        cover = np.clip((shape - 0.32 + 0.62 * light.clouds) * 2.6, 0.0, 1.0) * np.clip(
            up * 9.0, 0.0, 1.0
        )
        belly = 1.0 - 0.38 * np.clip(fractal(flat + 3.5, 0.5, 603, octaves=4) + 0.4, 0.0, 1.0)
        colour = colour + (white * belly[:, None] - colour) * (0.9 * cover)[:, None]
    else:
        colour = colour + (white * 0.85 - colour) * (0.4 * light.clouds)
    return colour


def dome(count: int, lowest: float) -> tuple[Array, float]:
    """Return evenly spread unit directions (N, 3) above z = `lowest`, and radians between them."""
    total = max(1, round(count * 2.0 / (1.0 - lowest)))
    index = np.arange(count, dtype=np.float64)
    z = 1.0 - (index + 0.5) * (2.0 / total)
    # The golden angle, in turns, kept small so that cos and sin are asked for exact arguments.
    turn = (index * 0.6180339887498949) % 1.0
    ring = np.sqrt(np.maximum(1.0 - z * z, 0.0))
    directions = np.stack(
        [ring * np.cos(2 * np.pi * turn), ring * np.sin(2 * np.pi * turn), z], axis=1
    )
    return directions, math.sqrt(4.0 * math.pi / total)
