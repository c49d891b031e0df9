"""Windows and doors, lamps and signs that shine."""

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
    frame,
    hashed,
    linear,
    pulse,
    step,
    tint,
)

_FRAME = 0.055


def casement(u: Array, v: Array, w: Array, h: Array, blur: Array) -> Array:
    """Return how much of a spot lies on the frame of a two-winged window."""
    rim = frame(u, v, w, h, _FRAME, blur)
    post = band(u, w / 2 - 0.035, w / 2 + 0.035, blur)
    bar = band(v, 0.70 * h - 0.02, 0.70 * h + 0.02, blur)
    return np.maximum(rim, np.maximum(post, bar))


def steel_frame(u: Array, v: Array, w: Array, h: Array, blur: Array) -> Array:
    """Return how much of a spot lies on the bars of a workshop window."""
    rim = frame(u, v, w, h, 0.03, blur)
    bars = np.maximum(pulse(u + 0.012, w / 4, 0.024, blur), pulse(v + 0.012, h / 3, 0.024, blur))
    return np.maximum(rim, bars)


def sky_glow(spots: Spots, up: Array) -> Array:
    """Return (N, 3) the radiance of the sky at a height `up` (N,) above the horizon, 0 to 1."""
    zenith = np.array(spots.light.zenith)
    horizon = np.array(spots.light.horizon)
    return horizon + (zenith - horizon) * np.clip(up, 0.0, 1.0)[:, None]


def _outside(spots: Spots) -> Array:
    """Return what a window shows from within: sky, and trees and roofs below it."""
    line = 0.42 * spots.h + 0.35 * fractal(
        np.stack([spots.p[:, 0] + spots.p[:, 1], np.zeros(len(spots))], axis=1),
        0.9, 411, octaves=3, blur=spots.blur,
    )  # fmt: skip
    sky = sky_glow(spots, (spots.v - line) / 1.6)
    leaves = fractal(spots.p, 0.16, 413, octaves=3, blur=spots.blur)
    trees = tint(linear("#93a78a") * 1.2, 0.5 * leaves) * np.array(spots.light.horizon).mean()
    return blend(trees, sky, step(spots.v, line, spots.blur + 0.05))


def window(spots: Spots, colour: Colour) -> Coat:
    """A window seen from within the room."""
    bars = casement(spots.u, spots.v, spots.w, spots.h, spots.blur)
    white = tint(colour, -0.25 * bars * hashed(415, np.floor(spots.v / 0.3)) * 0.2)
    return Coat(
        albedo=blend(np.full((len(spots), 3), 0.02), white, bars),
        glow=_outside(spots) * (1.0 - bars)[:, None],
    )


def portal(spots: Spots, colour: Colour) -> Coat:
    """The open end of a tunnel: what lies outside, without a frame."""
    return Coat(albedo=np.broadcast_to(colour, (len(spots), 3)).copy(), glow=_outside(spots))


def steel_window(spots: Spots, colour: Colour) -> Coat:
    """A workshop window: many panes, some of them dirty."""
    bars = steel_frame(spots.u, spots.v, spots.w, spots.h, spots.blur)
    pane = hashed(421, spots.seed, np.floor(4 * spots.u / spots.w), np.floor(3 * spots.v / spots.h))
    glow = _outside(spots) * (0.55 + 0.45 * pane)[:, None]
    return Coat(
        albedo=blend(np.full((len(spots), 3), 0.03), colour, bars),
        glow=glow * (1.0 - bars)[:, None],
    )


def _reflection(spots: Spots) -> Array:
    """Return what panes send back to somebody on the ground: sky, houses across, dark rooms."""
    up = spots.v / spots.h
    house = 0.45 + 0.5 * fractal(spots.p * 0.7, 1.3, 431, octaves=3, blur=spots.blur)
    sky = sky_glow(spots, 0.5 * up)
    return sky * (0.10 + 0.42 * step(up, house, np.full(len(spots), 0.22)))[:, None]


def house_window(spots: Spots, colour: Colour) -> Coat:
    """A window seen from the street: sill, frame, curtains, sky in the panes."""
    bars = casement(spots.u, spots.v, spots.w, spots.h, spots.blur)
    sill = 1.0 - step(spots.v, 0.07, spots.blur)
    shadow = step(spots.v, spots.h - 0.14, spots.blur)
    curtain = (
        (hashed(433, spots.seed, 1) > 0.4)
        * (1.0 - band(spots.u, 0.26 * spots.w, 0.74 * spots.w, spots.blur + 0.05))
        * (0.75 + 0.25 * pulse(spots.u, 0.07, 0.035, spots.blur))
    )
    glass = blend(np.full((len(spots), 3), 0.015), np.full(3, 0.42), 0.6 * curtain)
    albedo = blend(glass, colour, np.maximum(bars, sill))
    albedo = tint(albedo, -0.55 * shadow)
    glow = _reflection(spots) * ((1.0 - bars) * (1.0 - sill) * (1.0 - 0.6 * shadow))[:, None]
    return Coat(albedo=albedo, glow=glow * (1.0 - 0.5 * curtain)[:, None])


def house_window_lit(spots: Spots, colour: Colour) -> Coat:
    """The same in the evening: a lamp burns behind most of them."""
    day = house_window(spots, colour)
    bars = casement(spots.u, spots.v, spots.w, spots.h, spots.blur)
    on = hashed(435, spots.seed, 2) > 0.35
    depth = (
        0.65
        + 0.35 * (spots.v / spots.h)
        + 0.25 * fractal(spots.p, 0.5, 437, octaves=2, blur=spots.blur)
    )
    warm = linear("#ffb45a") * 1.3 * (depth * on * (1.0 - bars))[:, None]
    return Coat(albedo=day.albedo, glow=(0.0 if day.glow is None else day.glow) + warm)


def curtain_wall(spots: Spots, colour: Colour) -> Coat:
    """Storey-high glass between slim metal posts."""
    posts = np.maximum(
        frame(spots.u, spots.v, spots.w, spots.h, 0.05, spots.blur),
        pulse(spots.u + 0.025, spots.w / 3, 0.05, spots.blur),
    )
    rail = band(spots.v, 0.95, 1.0, spots.blur)
    posts = np.maximum(posts, rail)
    pane = hashed(441, spots.seed, np.floor(3 * spots.u / spots.w))
    blind = step(spots.v, spots.h * (0.55 + 0.4 * hashed(443, spots.seed)), spots.blur) * 0.5
    glass = blend(np.full((len(spots), 3), 0.03), np.full(3, 0.5), blind)
    glow = sky_glow(spots, spots.v / spots.h) * (0.26 + 0.16 * pane)[:, None]
    glow *= (0.55 + 0.45 * step(spots.v / spots.h, 0.35, np.full(len(spots), 0.4)))[:, None]
    return Coat(
        albedo=blend(glass, colour, posts), glow=glow * ((1.0 - posts) * (1 - 0.6 * blind))[:, None]
    )


def glass_doors(spots: Spots, colour: Colour) -> Coat:
    """Two glazed wings with daylight behind them."""
    rim = frame(spots.u, spots.v, spots.w, spots.h, 0.07, spots.blur)
    post = band(spots.u, spots.w / 2 - 0.07, spots.w / 2 + 0.07, spots.blur)
    rail = band(spots.v, 0.98, 1.06, spots.blur)
    kick = 1.0 - step(spots.v, 0.22, spots.blur)
    bars = np.clip(np.maximum(np.maximum(rim, post), np.maximum(rail, kick)), 0.0, 1.0)
    return Coat(
        albedo=blend(np.full((len(spots), 3), 0.02), colour, bars),
        glow=_outside(spots) * (0.95 * (1.0 - bars))[:, None],
    )


def door(spots: Spots, colour: Colour) -> Coat:
    """A door leaf in its frame, with a handle, a kick plate and a lock."""
    rim = frame(spots.u, spots.v, spots.w, spots.h, 0.06, spots.blur)
    rim = np.where(spots.v < 0.08, rim * 0.3, rim)
    fibres = fractal(
        np.stack([spots.u, spots.v * 0.06, (spots.seed % 17).astype(np.float64)], axis=1),
        0.05, 451, octaves=3, blur=spots.blur * 0.5,
    )  # fmt: skip
    albedo = tint(colour, 0.14 * fibres)
    gap = band(np.minimum(spots.u, spots.w - spots.u), 0.06, 0.068, spots.blur)
    plate = band(spots.v, 0.02, 0.24, spots.blur) * band(spots.u, 0.10, spots.w - 0.10, spots.blur)
    handle = band(spots.v, 1.02, 1.045, spots.blur) * band(
        spots.u, spots.w - 0.24, spots.w - 0.11, spots.blur
    )
    lock = band(spots.v, 0.93, 1.10, spots.blur) * band(
        spots.u, spots.w - 0.15, spots.w - 0.10, spots.blur
    )
    pane = band(spots.u, 0.30 * spots.w, 0.70 * spots.w, spots.blur) * band(
        spots.v, 1.25, 1.85, spots.blur
    ) * (hashed(453, spots.seed) > 0.5)  # fmt: skip
    albedo = blend(albedo, linear("#8d8d8a"), 0.6 * plate)
    albedo = blend(albedo, linear("#3a4a52"), 0.85 * pane)
    albedo = blend(albedo, linear("#c9c9c4"), np.clip(handle + 0.5 * lock, 0.0, 1.0))
    albedo = blend(albedo, linear("#dcd8cc"), rim)
    return Coat(albedo=tint(albedo, -0.7 * gap))


def doors(spots: Spots, colour: Colour) -> Coat:
    """A double door with panels and push bars."""
    rim = frame(spots.u, spots.v, spots.w, spots.h, 0.08, spots.blur)
    rim = np.where(spots.v < 0.09, 0.0, rim)
    half = spots.w / 2
    side = np.where(spots.u < half, spots.u, spots.u - half)
    gap = band(spots.u, half - 0.008, half + 0.008, spots.blur)
    field = band(side, 0.18 * half, 0.85 * half, spots.blur) * (
        band(spots.v, 0.25, 0.95, spots.blur) + band(spots.v, 1.15, spots.h - 0.25, spots.blur)
    )
    bar = band(spots.v, 1.0, 1.05, spots.blur) * band(side, 0.15 * half, 0.88 * half, spots.blur)
    fibres = fractal(spots.p * np.array([1.0, 1.0, 0.1]), 0.06, 461, octaves=3, blur=spots.blur)
    albedo = tint(colour, 0.14 * fibres - 0.22 * field - 0.8 * gap)
    albedo = blend(albedo, linear("#b9b6ac"), np.clip(bar, 0.0, 1.0))
    return Coat(albedo=blend(albedo, linear("#cfc9ba"), rim))


def roller_door(spots: Spots, colour: Colour) -> Coat:
    """Slats of a roller door."""
    slat = pulse(spots.v, 0.11, 0.035, spots.blur)
    rails = frame(spots.u, spots.v + 0.2, spots.w, spots.h + 0.2, 0.08, spots.blur)
    dents = fractal(spots.p, 0.8, 471, octaves=3, blur=spots.blur)
    dirt = np.clip(1.0 - spots.v / 0.5, 0.0, 1.0)
    albedo = tint(colour, 0.08 * dents - 0.35 * slat - 0.25 * dirt)
    return Coat(albedo=blend(albedo, linear("#4d5054"), rails))


def lamp(spots: Spots, colour: Colour) -> Coat:
    """A panel of light behind a diffuser."""
    rim = frame(spots.u, spots.v, spots.w, spots.h, 0.012, spots.blur)
    return Coat(
        albedo=np.full((len(spots), 3), 0.7),
        glow=colour * (3.2 * (1.0 - rim))[:, None],
    )


def glow(spots: Spots, colour: Colour) -> Coat:
    """Glass round a burning lamp."""
    return Coat(
        albedo=np.full((len(spots), 3), 0.3), glow=np.broadcast_to(colour * 3.0, (len(spots), 3))
    )


def milk_glass(spots: Spots, colour: Colour) -> Coat:
    """Glass round a lamp that is off."""
    return Coat(albedo=np.broadcast_to(colour, (len(spots), 3)).copy())


def exit_sign(spots: Spots, colour: Colour) -> Coat:
    """A lit green sign with a running figure's arrow."""
    arrow = band(spots.v, 0.35 * spots.h, 0.65 * spots.h, spots.blur) * band(
        spots.u, 0.15 * spots.w, 0.80 * spots.w, spots.blur
    )
    shine = blend(np.broadcast_to(colour, (len(spots), 3)), np.full(3, 0.9), arrow)
    return Coat(albedo=np.full((len(spots), 3), 0.2), glow=shine * 0.9)
