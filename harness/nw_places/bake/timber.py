"""Wood, board and other materials of obstacles and furniture."""

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
    noise,
    pulse,
    rim,
    tint,
)


def _fibres(u: Array, v: Array, seed: Array | int, blur: Array, stretch: float = 0.06) -> Array:
    """Return wood fibres along u, in [-1, 1]."""
    field = np.stack([u * stretch, v, np.asarray(seed, dtype=np.float64) * np.ones_like(u)], axis=1)
    return fractal(field, 0.045, 201, octaves=4, blur=blur * 0.4)


def plywood(spots: Spots, colour: Colour) -> Coat:
    """Birch ply: long flames of grain, knots, worn rims, scuffs from feet."""
    seed = (spots.seed % 97).astype(np.float64)
    flame = noise(np.stack([spots.u * 0.35, spots.v, seed], axis=1), 0.22, 203)
    rings = pulse(spots.v + 0.10 * flame + 0.02 * _fibres(spots.u, spots.v, seed, spots.blur),
                  0.055, 0.018, spots.blur)  # fmt: skip
    fibres = _fibres(spots.u, spots.v, seed, spots.blur)
    scuff = np.clip(fractal(spots.p, 0.30, 205, octaves=4, blur=spots.blur) - 0.25, 0.0, 1.0)
    knot_u, knot_v = np.floor(spots.u / 0.43), np.floor(spots.v / 0.21)
    there = hashed(spots.seed, knot_u, knot_v) > 0.72
    off_u = (0.2 + 0.6 * hashed(spots.seed, knot_u, knot_v, 1)) * 0.43
    off_v = (0.2 + 0.6 * hashed(spots.seed, knot_u, knot_v, 2)) * 0.21
    away = np.hypot((spots.u - knot_u * 0.43 - off_u) * 0.7, spots.v - knot_v * 0.21 - off_v)
    knot = there * np.clip(1.4 - away / 0.016, 0.0, 1.0)
    shade = 0.16 * fibres - 0.16 * rings - 0.45 * scuff + 0.05 * grain(spots, 207)
    albedo = tint(colour, shade)
    albedo = blend(albedo, linear("#6b4526"), 0.75 * knot)
    return Coat(albedo=blend(albedo, np.minimum(colour * 1.25, 0.85), 0.5 * rim(spots, 0.015)))


def planks(spots: Spots, colour: Colour) -> Coat:
    """Boards of 9 cm along the longer side, with gaps, nails and weather."""
    long_u = spots.w >= spots.h
    along = np.where(long_u, spots.u, spots.v)
    across = np.where(long_u, spots.v, spots.u)
    board = np.floor(across / 0.092).astype(np.int64)
    tone = 2.0 * hashed(spots.seed, board) - 1.0
    gap = pulse(across + 0.004, 0.092, 0.008, spots.blur)
    fibres = _fibres(along, across, tone * 9.0 + (spots.seed % 31), spots.blur)
    weather = fractal(spots.p, 0.7, 213, octaves=4, blur=spots.blur)
    within = across - board * 0.092
    nail_u = np.abs((along + 0.04) % 0.52 - 0.08)
    nail = (nail_u < 0.006 + 0.3 * spots.blur) & (np.abs(within - 0.046) < 0.006 + 0.3 * spots.blur)
    shade = 0.20 * tone + 0.26 * fibres + 0.10 * weather
    albedo = tint(colour, shade)
    albedo = blend(albedo, colour * 0.12, gap * 0.92)
    albedo = blend(albedo, linear("#3a3735"), nail * np.clip(0.006 / spots.blur, 0.0, 0.6))
    return Coat(albedo=blend(albedo, np.minimum(colour * 1.35, 0.8), 0.35 * rim(spots, 0.012)))


def _cracks(along: Array, across: Array, spots: Spots) -> Array:
    """Return drying cracks along the grain, 0 to 1."""
    row = np.floor(across / 0.055)
    line = np.stack([along, row * 7.0 + (spots.seed % 53)], axis=1)
    middle = (0.3 + 0.4 * hashed(spots.seed, row, 221)) * 0.055 + 0.007 * noise(line, 0.16, 222)
    there = np.clip(3.0 * noise(line, 0.45, 223) + 0.2, 0.0, 1.0)
    reach = 0.0025 + 0.6 * spots.blur
    return (
        there
        * np.clip(1.0 - np.abs(across - row * 0.055 - middle) / reach, 0.0, 1.0)
        * np.clip(0.008 / reach, 0.0, 1.0)
    )


def timber(spots: Spots, colour: Colour) -> Coat:
    """A squared beam: deep cracks along it, bolt holes, rough rims."""
    long_u = spots.w >= spots.h
    along = np.where(long_u, spots.u, spots.v)
    across = np.where(long_u, spots.v, spots.u)
    seed = (spots.seed % 53).astype(np.float64)
    fibres = _fibres(along, across, seed, spots.blur, 0.05)
    crack = _cracks(along, across, spots)
    weather = fractal(spots.p, 0.45, 223, octaves=4, blur=spots.blur)
    short = np.minimum(spots.w, spots.h) < 0.45
    ends = short & (np.maximum(spots.w, spots.h) < 0.6)
    rings = pulse(
        np.hypot(spots.s - spots.w * 0.45, spots.t - spots.h * 0.4) + 0.01 * weather,
        0.022, 0.008, spots.blur,
    )  # fmt: skip
    shade = 0.28 * fibres + 0.20 * weather + 0.08 * grain(spots, 225)
    shade = shade - np.where(ends, 0.35 * rings, 0.75 * crack)
    albedo = tint(colour, shade)
    return Coat(albedo=blend(albedo, np.minimum(colour * 1.8, 0.6), 0.35 * rim(spots, 0.02)))


def veneer(spots: Spots, colour: Colour) -> Coat:
    """Furniture board with a fine grain and a light edge."""
    fibres = _fibres(spots.u, spots.v, (spots.seed % 41).astype(np.float64), spots.blur)
    return Coat(albedo=tint(colour, 0.10 * fibres + 0.12 * rim(spots, 0.01)))


def foam(spots: Spots, colour: Colour) -> Coat:
    """A gym block in vinyl: creases, seams near the edges, dusty footprints on top."""
    creases = fractal(spots.p, 0.25, 231, octaves=4, blur=spots.blur)
    near = np.minimum(
        np.minimum(spots.s, spots.w - spots.s), np.minimum(spots.t, spots.h - spots.t)
    )
    seam = band(near, 0.018, 0.026, spots.blur)
    dust = np.clip(fractal(spots.p, 0.22, 233, octaves=4, blur=spots.blur) - 0.2, 0.0, 1.0)
    albedo = tint(colour, 0.14 * creases - 0.4 * seam + 0.05 * grain(spots, 235))
    albedo = blend(albedo, linear("#9b948c"), 0.5 * dust * (0.35 + 0.65 * (spots.n[:, 2] > 0.5)))
    return Coat(albedo=blend(albedo, np.minimum(colour * 1.5, 0.9), 0.3 * rim(spots, 0.012)))


def rubber(spots: Spots, colour: Colour) -> Coat:
    """Recycled rubber: black crumbs with coloured flecks."""
    cell = np.floor(spots.p / 0.012).astype(np.int64)
    pick = hashed(241, cell[:, 0], cell[:, 1], cell[:, 2])
    fade = np.clip(1.8 - spots.blur / 0.025, 0.15, 1.0)
    albedo = tint(colour, 0.35 * (2.0 * pick - 1.0) * fade)
    albedo = blend(albedo, linear("#a4452e"), 0.7 * fade * (pick > 0.93))
    albedo = blend(albedo, linear("#5f7f9a"), 0.6 * fade * ((pick > 0.88) & (pick <= 0.93)))
    dust = np.clip(fractal(spots.p, 0.4, 243, octaves=4, blur=spots.blur) - 0.05, 0.0, 1.0)
    albedo = blend(albedo, linear("#8b857c"), 0.45 * dust)
    return Coat(albedo=blend(albedo, linear("#77736d"), 0.4 * rim(spots, 0.012)))


def kerb(spots: Spots, colour: Colour) -> Coat:
    """A wheel stop: yellow paint with black bars on concrete, chipped by tyres."""
    bars = pulse(spots.p[:, 1] + 0.5 * spots.p[:, 2], 0.36, 0.16, spots.blur)
    albedo = blend(tint(colour, 0.06 * grain(spots, 251)), linear("#26262a"), bars)
    chips = np.clip(
        2.6 * (fractal(spots.p, 0.16, 253, octaves=4, blur=spots.blur) - 0.26), 0.0, 1.0
    )
    worn = rim(spots, 0.03) * np.clip(
        0.6 + fractal(spots.p, 0.08, 255, octaves=2, blur=spots.blur), 0.0, 1.0
    )
    marks = np.clip(fractal(spots.p, 0.5, 257, octaves=3, blur=spots.blur), 0.0, 1.0)
    albedo = blend(albedo, linear("#9c978e"), np.clip(chips + 0.7 * worn, 0.0, 1.0))
    return Coat(albedo=tint(albedo, -0.35 * marks))


def cardboard(spots: Spots, colour: Colour) -> Coat:
    """A carton with tape and a printed mark."""
    creases = fractal(spots.p, 0.3, 261, octaves=3, blur=spots.blur)
    tape = band(spots.s, spots.w / 2 - 0.025, spots.w / 2 + 0.025, spots.blur)
    mark = band(spots.s, 0.62 * spots.w, 0.86 * spots.w, spots.blur) * band(
        spots.t, 0.25 * spots.h, 0.55 * spots.h, spots.blur
    )
    albedo = tint(colour, 0.10 * creases + 0.10 * rim(spots, 0.012))
    albedo = blend(albedo, linear("#c9ad7b"), 0.6 * tape)
    return Coat(albedo=blend(albedo, linear("#5a4630"), 0.6 * mark))


def metal(spots: Spots, colour: Colour) -> Coat:
    """Painted steel: runs, rust at the rims, scratches."""
    stains = fractal(
        np.stack([spots.p[:, 0] * 2, spots.p[:, 1] * 2, spots.p[:, 2] * 0.5], axis=1),
        0.5, 271, octaves=4, blur=spots.blur,
    )  # fmt: skip
    rust = np.clip(
        fractal(spots.p, 0.25, 273, octaves=4, blur=spots.blur) - 0.42 + 0.3 * rim(spots, 0.04),
        0.0, 1.0,
    )  # fmt: skip
    albedo = tint(colour, 0.12 * stains + 0.15 * rim(spots, 0.008))
    return Coat(albedo=blend(albedo, linear("#6e4026"), np.clip(2.0 * rust, 0.0, 0.8)))


def plain(spots: Spots, colour: Colour) -> Coat:
    """Plastic, clay and whatever else is of one colour."""
    wear = fractal(spots.p, 0.35, 281, octaves=3, blur=spots.blur)
    return Coat(albedo=tint(colour, 0.06 * wear + 0.10 * rim(spots, 0.006)))


def bark(spots: Spots, colour: Colour) -> Coat:
    """Furrowed bark."""
    field = np.stack([spots.p[:, 0], spots.p[:, 1], spots.p[:, 2] * 0.22], axis=1)
    furrows = fractal(field, 0.06, 291, octaves=3, blur=spots.blur * 0.5)
    moss = np.clip(fractal(spots.p, 0.5, 293, octaves=3, blur=spots.blur) - 0.15, 0.0, 1.0)
    albedo = tint(colour, 0.5 * furrows + 0.12 * grain(spots, 295))
    return Coat(albedo=blend(albedo, linear("#66704a"), 0.6 * moss))


def car_paint(spots: Spots, colour: Colour) -> Coat:
    """Lacquer: the sky above in upper faces, road dust below, door seams."""
    up = np.clip(spots.n[:, 2], 0.0, 1.0)
    sheen = np.clip((spots.p[:, 2] - 0.55) / 0.35, 0.0, 1.0)
    albedo = blend(
        np.broadcast_to(colour, (len(spots), 3)), linear("#b9c6d6"), 0.16 + 0.22 * up + 0.10 * sheen
    )
    dust = np.clip((0.45 - spots.p[:, 2]) / 0.35, 0.0, 1.0)
    albedo = blend(albedo, linear("#77716a"), 0.35 * dust)
    seam = np.where(
        spots.w > 3.0,
        band(spots.u, 0.38 * spots.w, 0.38 * spots.w + 0.015, spots.blur)
        + band(spots.u, 0.62 * spots.w, 0.62 * spots.w + 0.015, spots.blur),
        0.0,
    )
    return Coat(albedo=tint(albedo, -0.6 * np.clip(seam, 0.0, 1.0)))
