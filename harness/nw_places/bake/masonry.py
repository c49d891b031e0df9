"""Walls, ceilings and roofs."""

from __future__ import annotations

import numpy as np

from nw_places.bake.spots import (
    Array,
    Coat,
    Colour,
    Spots,
    band,
    blend,
    fractal,
    grain,
    hashed,
    linear,
    pulse,
    tiles,
    tint,
)


def _damp(spots: Spots) -> Array:
    """Return how much rising damp and splashed dirt darken a wall near the ground, 0 to 1."""
    edge = 0.35 + 0.25 * fractal(spots.p, 0.6, 301, octaves=4, blur=spots.blur)
    return np.clip(1.0 - spots.p[:, 2] / np.maximum(edge, 0.05), 0.0, 1.0)


def _streaks(spots: Spots) -> Array:
    """Return rain streaks, in [-1, 1]."""
    field = np.stack([spots.p[:, 0], spots.p[:, 1], spots.p[:, 2] * 0.08], axis=1)
    return fractal(field, 0.35, 303, octaves=4, blur=spots.blur)


def plaster(spots: Spots, colour: Colour) -> Coat:
    """Painted plaster indoors: roller texture, faint shadows, scuffs above the skirting."""
    clouds = fractal(spots.p, 1.4, 311, octaves=3, blur=spots.blur)
    scuffs = np.clip(fractal(spots.p, 0.30, 313, octaves=4, blur=spots.blur) - 0.30, 0.0, 1.0)
    low = np.clip(1.2 - spots.p[:, 2] / 0.7, 0.0, 1.0)
    shade = 0.035 * clouds + 0.02 * grain(spots, 315) - 0.9 * scuffs * low - 0.05 * low
    return Coat(albedo=tint(colour, shade))


def brick(spots: Spots, colour: Colour) -> Coat:
    """Brickwork in running bond: burnt headers, lime joints, soot and rain."""
    laid = tiles(
        spots.u, spots.v, size=(0.225, 0.075), joint=0.012, blur=spots.blur, seed=321, shift=0.5
    )
    hue = 2.0 * hashed(323, laid.column, laid.row) - 1.0
    burnt = hashed(325, laid.column, laid.row) > 0.94
    seen = np.clip(1.6 - spots.blur / 0.14, 0.10, 1.0)
    shade = 0.32 * laid.shade + 0.10 * grain(spots, 327) * seen - 0.38 * burnt * seen
    shade += 0.10 * _streaks(spots) + 0.12 * fractal(spots.p, 1.7, 329, octaves=3, blur=spots.blur)
    albedo = tint(colour, shade) * (
        1.0 + (0.16 * hue * seen)[:, None] * np.array([0.5, -0.3, -0.8])
    )
    mortar = tint(linear("#aaa195"), 0.15 * fractal(spots.p, 0.3, 331, octaves=3, blur=spots.blur))
    albedo = blend(albedo, mortar, laid.joint)
    return Coat(albedo=blend(albedo, linear("#474036"), 0.45 * _damp(spots)))


def block_wall(spots: Spots, colour: Colour) -> Coat:
    """Painted concrete blocks."""
    laid = tiles(
        spots.u, spots.v, size=(0.40, 0.20), joint=0.010, blur=spots.blur, seed=341, shift=0.5
    )
    marks = np.clip(fractal(spots.p, 0.5, 343, octaves=4, blur=spots.blur) - 0.15, 0.0, 1.0)
    shade = 0.04 * laid.shade - 0.32 * laid.joint + 0.05 * grain(spots, 345) - 0.35 * marks
    return Coat(albedo=tint(colour, shade))


def stucco(spots: Spots, colour: Colour) -> Coat:
    """Rendered outside walls."""
    rough = fractal(spots.p, 0.10, 351, octaves=3, blur=spots.blur)
    fading = fractal(spots.p, 2.5, 353, octaves=3, blur=spots.blur)
    albedo = tint(colour, 0.10 * rough + 0.10 * fading + 0.12 * _streaks(spots))
    return Coat(albedo=blend(albedo, linear("#5c564c"), 0.5 * _damp(spots)))


def panels(spots: Spots, colour: Colour) -> Coat:
    """Large façade panels with open joints."""
    laid = tiles(spots.u, spots.v, size=(1.75, 1.0), joint=0.018, blur=spots.blur, seed=361)
    shade = 0.05 * laid.shade + 0.06 * _streaks(spots)
    return Coat(albedo=tint(tint(colour, shade), -0.75 * laid.joint))


def corrugated(spots: Spots, colour: Colour) -> Coat:
    """Ribbed sheet metal: light and dark flanks, rust along the joints."""
    seen = np.clip(1.5 - spots.blur / 0.10, 0.0, 1.0)
    flank = pulse(spots.u, 0.20, 0.10, spots.blur) - 0.5
    joint = pulse(spots.v + 0.3, 2.4, 0.02, spots.blur)
    albedo = tint(colour, 0.45 * flank * seen + 0.10 * _streaks(spots) - 0.4 * joint)
    rust = np.clip(_streaks(spots) - 0.35, 0.0, 1.0)
    return Coat(albedo=blend(albedo, linear("#7a4a2c"), np.clip(1.4 * rust, 0.0, 0.5)))


def ceiling_tiles(spots: Spots, colour: Colour) -> Coat:
    """Mineral-fibre tiles in a white grid."""
    laid = tiles(spots.u, spots.v, size=(0.6, 0.6), joint=0.022, blur=spots.blur, seed=371)
    pin = (hashed(373, *np.floor(spots.p / 0.02).astype(np.int64).T) > 0.8) * np.clip(
        1.5 - spots.blur / 0.03, 0.0, 1.0
    )
    albedo = tint(colour, 0.03 * laid.shade - 0.15 * pin)
    return Coat(albedo=blend(albedo, linear("#ffffff") * 0.6, 0.5 * laid.joint))


def roof(spots: Spots, colour: Colour) -> Coat:
    """Clay roof tiles."""
    laid = tiles(spots.u, spots.v, size=(0.25, 0.33), joint=0.03, blur=spots.blur, seed=381)
    return Coat(albedo=tint(colour, 0.25 * laid.shade - 0.5 * laid.joint))


def skirting(spots: Spots, colour: Colour) -> Coat:
    """A painted board along the foot of a wall."""
    top = band(spots.v, spots.h - 0.012, spots.h, spots.blur)
    scuffs = np.clip(fractal(spots.p, 0.25, 391, octaves=4, blur=spots.blur) - 0.2, 0.0, 1.0)
    return Coat(albedo=tint(colour, -0.35 * top - 0.8 * scuffs))


def coping(spots: Spots, colour: Colour) -> Coat:
    """Cover stones of a low wall, one beside another."""
    joint = pulse(np.where(spots.w > spots.h, spots.u, spots.v), 0.45, 0.012, spots.blur)
    rough = fractal(spots.p, 0.25, 395, octaves=4, blur=spots.blur)
    lichen = np.clip(fractal(spots.p, 0.2, 397, octaves=3, blur=spots.blur) - 0.3, 0.0, 1.0)
    albedo = tint(colour, 0.18 * rough + 0.08 * grain(spots, 399) - 0.55 * joint)
    return Coat(albedo=blend(albedo, linear("#a8a272"), np.clip(1.5 * lichen, 0.0, 0.6)))
