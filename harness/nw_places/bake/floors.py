"""Materials underfoot."""

from __future__ import annotations

import numpy as np

from nw_places.bake.spots import (
    Coat,
    Colour,
    Spots,
    band,
    blend,
    fractal,
    grain,
    hashed,
    linear,
    noise,
    pulse,
    step,
    tiles,
    tint,
)

_MOSS = linear("#5d6638")
_DIRT = linear("#4a4238")


def carpet(spots: Spots, colour: Colour) -> Coat:
    """Loop pile: fine fibres, rows, trodden lanes, the odd fleck."""
    lanes = fractal(spots.p[:, :2], 1.3, 3, octaves=3, blur=spots.blur)
    fibre = fractal(spots.p, 0.06, 5, octaves=3, blur=spots.blur * 0.6)
    rows = pulse(spots.v, 0.05, 0.02, spots.blur) - 0.4
    pile = grain(spots, 11)
    albedo = tint(colour, 0.14 * lanes + 0.20 * fibre + 0.10 * rows + 0.16 * pile)
    fleck = (
        hashed(19, np.floor(spots.p[:, 0] / 0.02), np.floor(spots.p[:, 1] / 0.02)) > 0.94
    ) * 0.35
    return Coat(albedo=blend(albedo, np.minimum(colour * 2.2, 0.7), fleck))


def carpet_tiles(spots: Spots, colour: Colour) -> Coat:
    """Carpet squares of 50 cm, each turned against its neighbours."""
    cut = tiles(spots.u, spots.v, size=(0.5, 0.5), joint=0.008, blur=spots.blur, seed=21)
    turned = (cut.column + cut.row) % 2 == 0
    along = np.where(turned, spots.u, spots.v)
    stripe = pulse(along, 0.10, 0.035, spots.blur) - 0.35
    fibre = fractal(spots.p, 0.05, 23, octaves=3, blur=spots.blur * 0.6)
    worn = fractal(spots.p[:, :2], 1.6, 25, octaves=2, blur=spots.blur)
    shade = 0.10 * cut.shade + 0.16 * stripe + 0.15 * fibre + 0.08 * worn
    shade += 0.12 * grain(spots, 27) + np.where(turned, 0.06, -0.06)
    return Coat(albedo=tint(tint(colour, shade), -0.35 * cut.joint))


def parquet(spots: Spots, colour: Colour) -> Coat:
    """Floor boards along the course, each with a grain and a shade of its own."""
    boards = tiles(
        spots.u, spots.v, size=(1.4, 0.095), joint=0.005, blur=spots.blur, seed=31, loose=True
    )
    stretched = np.stack([spots.p[:, 0] * 0.09, spots.p[:, 1], spots.p[:, 2]], axis=1)
    stretched[:, 2] += 3.1 * (boards.column % 17) + 1.7 * (boards.row % 29)
    flame = fractal(stretched, 0.05, 33, octaves=3, blur=spots.blur * 0.5)
    scuff = fractal(spots.p[:, :2], 0.9, 35, octaves=3, blur=spots.blur)
    shade = 0.24 * boards.shade + 0.22 * flame + 0.08 * scuff
    warm = colour * np.array([1.05, 0.97, 0.85])
    albedo = blend(tint(colour, shade), warm, 0.5 + 0.5 * boards.shade)
    albedo = tint(albedo, shade * 0.8)
    albedo = tint(albedo, -0.65 * boards.joint)
    return Coat(albedo=albedo)


def linoleum(spots: Spots, colour: Colour) -> Coat:
    """Sheet floor with clouds and chips, welded every two metres."""
    clouds = fractal(spots.p[:, :2], 0.5, 41, octaves=4, blur=spots.blur)
    chips = grain(spots, 43)
    shade = 0.12 * clouds + 0.13 * chips
    weld = pulse(spots.v + 0.66, 1.33, 0.008, spots.blur)
    scuff = np.clip(fractal(spots.p[:, :2], 0.35, 47, octaves=3, blur=spots.blur) - 0.35, 0.0, 1.0)
    albedo = tint(colour, shade - 0.5 * weld - 0.6 * scuff)
    chip = hashed(45, np.floor(spots.p[:, 0] / 0.013), np.floor(spots.p[:, 1] / 0.013)) > 0.9
    return Coat(albedo=blend(albedo, np.minimum(colour * 1.7, 0.8), chip * 0.4))


def concrete(spots: Spots, colour: Colour) -> Coat:
    """Cast concrete: clouds, pores, stains and hairline cracks."""
    clouds = fractal(spots.p, 1.1, 51, octaves=5, blur=spots.blur)
    pores = (hashed(53, *np.floor(spots.p / 0.011).astype(np.int64).T) > 0.965) * np.clip(
        1.6 - spots.blur / 0.02, 0.0, 1.0
    )
    crack_field = noise(spots.p, 0.9, 55) + 0.35 * noise(spots.p, 0.21, 56)
    crack = np.clip(1.0 - np.abs(crack_field - 0.12) / (0.006 + 0.35 * spots.blur), 0.0, 1.0)
    stain = np.clip(fractal(spots.p, 0.6, 57, octaves=3, blur=spots.blur) - 0.30, 0.0, 1.0)
    shade = 0.22 * clouds + 0.07 * grain(spots, 59) - 0.22 * pores - 0.28 * crack - 0.55 * stain
    return Coat(albedo=tint(colour, shade))


def tarmac(spots: Spots, colour: Colour) -> Coat:
    """Asphalt: light and dark stones in bitumen, patches, mended cracks."""
    stones = grain(spots, 61)
    coarse = fractal(spots.p[:, :2], 0.045, 62, octaves=2, blur=spots.blur * 0.6)
    patches = fractal(spots.p[:, :2], 2.3, 63, octaves=4, blur=spots.blur)
    crack_field = noise(spots.p[:, :2], 1.7, 65) + 0.3 * noise(spots.p[:, :2], 0.3, 66)
    crack = np.clip(1.0 - np.abs(crack_field - 0.05) / (0.012 + 0.3 * spots.blur), 0.0, 1.0)
    fade = np.clip(1.7 - spots.blur / 0.05, 0.25, 1.0)
    shade = 0.34 * stones * fade + 0.22 * coarse + 0.22 * patches - 0.4 * crack
    light = (hashed(67, *np.floor(spots.p / 0.011).astype(np.int64).T) > 0.93) * fade
    return Coat(albedo=blend(tint(colour, shade), linear("#a9a49b"), 0.35 * light))


def gravel(spots: Spots, colour: Colour) -> Coat:
    """Fine gravel: pebbles of many colours, darker where it is damp."""
    cell = np.floor(spots.p / 0.019).astype(np.int64)
    pebble = 2.0 * hashed(71, cell[:, 0], cell[:, 1]) - 1.0
    hue = 2.0 * hashed(72, cell[:, 0], cell[:, 1]) - 1.0
    fade = np.clip(1.8 - spots.blur / 0.04, 0.12, 1.0)
    coarse = fractal(spots.p[:, :2], 0.09, 76, octaves=2, blur=spots.blur * 0.7)
    damp = fractal(spots.p[:, :2], 1.8, 73, octaves=4, blur=spots.blur)
    ruts = band(np.abs(spots.p[:, 1]), 0.35, 0.75, np.full(len(spots), 0.5)) - 0.4
    albedo = tint(
        colour,
        0.42 * pebble * fade + 0.20 * grain(spots, 77) + 0.16 * coarse + 0.20 * damp + 0.08 * ruts,
    )
    warmth = 1.0 + (0.12 * hue * fade)[:, None] * np.array([1.0, 0.1, -1.0])
    weeds = np.clip(fractal(spots.p[:, :2], 0.7, 75, octaves=4, blur=spots.blur) - 0.34, 0.0, 0.3)
    return Coat(albedo=blend(albedo * warmth, _MOSS, 2.2 * weeds))


def soil(spots: Spots, colour: Colour) -> Coat:
    """Earth in beds: crumbs, bark, shade."""
    clods = fractal(spots.p, 0.16, 81, octaves=4, blur=spots.blur)
    return Coat(albedo=tint(colour, 0.45 * clods + 0.3 * grain(spots, 83)))


def grass(spots: Spots, colour: Colour) -> Coat:
    """The ground of a lawn, between and beyond its blades."""
    patches = fractal(spots.p[:, :2], 2.6, 91, octaves=4, blur=spots.blur)
    tufts = fractal(spots.p[:, :2], 0.22, 93, octaves=3, blur=spots.blur * 0.7)
    dry = np.clip(fractal(spots.p[:, :2], 1.1, 95, octaves=4, blur=spots.blur) - 0.12, 0.0, 1.0)
    albedo = tint(colour, 0.22 * patches + 0.35 * tufts + 0.25 * grain(spots, 97))
    return Coat(albedo=blend(albedo, linear("#8f8a4a"), 0.9 * dry))


def pavers(spots: Spots, colour: Colour) -> Coat:
    """Clay pavers in running bond with sand and moss between them."""
    laid = tiles(
        spots.v, spots.u, size=(0.21, 0.105), joint=0.009, blur=spots.blur, seed=101, shift=0.5
    )
    hue = 2.0 * hashed(103, laid.column, laid.row) - 1.0
    seen = np.clip(1.5 - spots.blur / 0.1, 0.1, 1.0)
    wear = fractal(spots.p[:, :2], 1.4, 105, octaves=5, blur=spots.blur)
    rim = 1.0 - band(laid.u, 0.012, 0.198, spots.blur) * band(laid.v, 0.012, 0.093, spots.blur)
    shade = 0.26 * laid.shade + 0.14 * wear + 0.12 * grain(spots, 107) - 0.14 * rim * seen
    albedo = tint(colour, shade) * (
        1.0 + (0.14 * hue * seen)[:, None] * np.array([0.6, -0.2, -0.7])
    )
    moss = np.clip(0.25 + fractal(spots.p[:, :2], 0.8, 109, octaves=3, blur=spots.blur), 0.0, 1.0)
    sand = blend(np.broadcast_to(linear("#8a7c68"), albedo.shape), _MOSS * 0.8, moss)
    return Coat(albedo=blend(albedo, sand * 0.62, laid.joint))


def slabs(spots: Spots, colour: Colour) -> Coat:
    """Sawn stone slabs of 60 by 40 cm, each a little different, with dark joints."""
    laid = tiles(
        spots.u, spots.v, size=(0.60, 0.40), joint=0.009, blur=spots.blur, seed=111, shift=0.5
    )
    hue = 2.0 * hashed(113, laid.column, laid.row) - 1.0
    veins = fractal(spots.p + laid.shade[:, None] * 3.0, 0.35, 115, octaves=4, blur=spots.blur)
    dirt = fractal(spots.p[:, :2], 2.2, 117, octaves=5, blur=spots.blur)
    seen = np.clip(1.5 - spots.blur / 0.4, 0.1, 1.0)
    shade = 0.15 * laid.shade + 0.12 * veins + 0.12 * dirt + 0.08 * grain(spots, 119)
    albedo = tint(colour, shade) * (1.0 + (0.05 * hue * seen)[:, None] * np.array([1.0, 0.2, -0.9]))
    gum = hashed(121, *np.floor(spots.p / 0.045).astype(np.int64).T) > 0.9975
    return Coat(albedo=tint(blend(albedo, _DIRT * 0.9, laid.joint * 0.9), -0.4 * gum))


def floor_tiles(spots: Spots, colour: Colour) -> Coat:
    """Glazed floor tiles of 30 cm with light grout."""
    laid = tiles(spots.u, spots.v, size=(0.30, 0.30), joint=0.008, blur=spots.blur, seed=171)
    clouds = fractal(spots.p, 0.25, 173, octaves=3, blur=spots.blur)
    worn = fractal(spots.p[:, :2], 1.5, 175, octaves=3, blur=spots.blur)
    shade = 0.13 * laid.shade + 0.08 * clouds + 0.08 * worn + 0.05 * grain(spots, 177)
    return Coat(albedo=blend(tint(colour, shade), linear("#a7a196"), 0.8 * laid.joint))


def grating(spots: Spots, colour: Colour) -> Coat:
    """A steel grating: bright bars over dark holes, a flat bar round its rim."""
    bars = np.maximum(
        pulse(spots.u, 0.034, 0.010, spots.blur), pulse(spots.v, 0.068, 0.012, spots.blur)
    )
    edge = 1.0 - band(spots.u, 0.02, spots.w - 0.02, spots.blur) * band(
        spots.v, 0.02, spots.h - 0.02, spots.blur
    )
    shine = tint(colour, 0.15 * grain(spots, 181))
    return Coat(albedo=blend(colour * 0.22, shine, np.clip(bars + edge, 0.0, 1.0)))


def granite(spots: Spots, colour: Colour) -> Coat:
    """Speckled stone."""
    crystals = grain(spots, 131)
    clouds = fractal(spots.p, 0.12, 133, octaves=3, blur=spots.blur * 0.7)
    fade = np.clip(1.7 - spots.blur / 0.04, 0.2, 1.0)
    white = (hashed(135, *np.floor(spots.p / 0.009).astype(np.int64).T) > 0.90) * fade
    albedo = tint(colour, 0.35 * crystals * fade + 0.18 * clouds)
    return Coat(albedo=blend(albedo, np.minimum(colour * 4.0 + 0.06, 0.7), 0.4 * white))


def drain(spots: Spots, colour: Colour) -> Coat:
    """A cast-iron cover."""
    bars = pulse(spots.u, 0.06, 0.028, spots.blur)
    rim = 1.0 - band(spots.u, 0.05, spots.w - 0.05, spots.blur) * band(
        spots.v, 0.05, spots.h - 0.05, spots.blur
    )
    return Coat(albedo=blend(tint(colour, 0.2 * grain(spots, 141)), colour * 0.15,
                             bars * (1.0 - rim)))  # fmt: skip


def stripe(spots: Spots, colour: Colour) -> Coat:
    """Road paint, worn through to the tarmac."""
    worn = np.clip(0.25 + 1.2 * fractal(spots.p[:, :2], 0.25, 151, octaves=4, blur=spots.blur),
                   0.0, 1.0)  # fmt: skip
    under = tarmac(spots, linear("#4b4b4d")).albedo
    return Coat(albedo=blend(tint(colour, 0.12 * grain(spots, 153)), under, 0.55 * worn))


def arrow(spots: Spots, colour: Colour) -> Coat:
    """A painted arrow that points along the course."""
    middle = np.abs(spots.v - spots.h / 2)
    shaft = band(spots.u, 0.0, 0.6 * spots.w, spots.blur) * (1 - step(middle, 0.10, spots.blur))
    reach = (spots.w - spots.u) / (0.4 * spots.w) * 0.38
    head = band(spots.u, 0.6 * spots.w, spots.w, spots.blur) * (1 - step(middle, reach, spots.blur))
    under = tarmac(spots, linear("#4b4b4d")).albedo
    paint = stripe(spots, colour).albedo
    return Coat(albedo=blend(under, paint, np.clip(shaft + head, 0.0, 1.0)))


def oil_stain(spots: Spots, colour: Colour) -> Coat:
    """A dark, uneven spot left by an engine."""
    radius = np.hypot(spots.u - spots.w / 2, spots.v - spots.h / 2) / (spots.w / 2)
    edge = radius + 0.5 * fractal(spots.p[:, :2], 0.4, 161, octaves=3, blur=spots.blur)
    under = tarmac(spots, linear("#4b4b4d")).albedo
    return Coat(albedo=blend(under, colour, np.clip(1.25 - 1.5 * edge, 0.0, 0.85)))
