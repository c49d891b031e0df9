"""From radiance to what a camera's picture shows."""

from __future__ import annotations

import numpy as np

from nw_eval.built_in.bake.surfels import eye_distance
from nw_eval.built_in.paint.noise import Array
from nw_eval.built_in.places.parts import Place

_LUMA = np.array([0.2126, 0.7152, 0.0722])
# What the middle of the picture is exposed to, before the tone curve, indoors and outdoors.
_MIDDLE_GREY = {True: 0.17, False: 0.24}

# How far automatic white balance goes towards grey, 0 to 1.
_WHITE_BALANCE = 0.55


def exposure(place: Place, points: Array, fallen: Array, radiance: Array) -> Array:
    """Return the factors (3,) that a camera's automatic exposure and white balance would choose.

    Args:
        place: whose trail the camera follows.
        points: (N, 3) metres.
        fallen: (N, 3) light that falls on them.
        radiance: (N, 3) light that they send back.
    """
    near = eye_distance(points, place.eyes) < 6.0
    white = np.median(fallen[near], axis=0)
    gain = (float((white * _LUMA).sum()) / np.maximum(white, 1e-4)) ** _WHITE_BALANCE
    luma = (radiance[near] * gain * _LUMA).sum(axis=1)
    grey = _MIDDLE_GREY[place.indoor] * place.light.exposure
    return gain * grey / max(float(np.median(luma)), 1e-4)


def display(radiance: Array, scale: Array) -> Array:
    """Return sRGB values 0 to 1 of linear radiance (N, 3), through a film-like curve."""
    x = np.maximum(radiance * scale, 0.0)
    # Reinhard's curve with a white point: a long shoulder, so that windows do not burn out hard.
    curve = np.clip(1.05 * x * (1.0 + x / 12.0) / (1.0 + x), 0.0, 1.0)
    # A film's contrast: darker shadows, brighter lights.
    shown = np.where(curve <= 0.0031308, 12.92 * curve, 1.055 * curve ** (1 / 2.4) - 0.055)
    return np.clip(shown + 0.35 * shown * (1.0 - shown) * (shown - 0.5), 0.0, 1.0)
