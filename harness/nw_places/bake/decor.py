"""Pictures, books, notices, fittings and the details of cars."""

from __future__ import annotations

import numpy as np

from nw_base import same_bits
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
    noise,
    pulse,
    step,
    tint,
)
from nw_places.bake.timber import car_paint

_BOOKS = np.array(
    [
        linear(code)
        for code in (
            "#7c2b25", "#1f3d63", "#c9b68c", "#2f5a3a", "#d8d4c8", "#39363b",
            "#a8692e", "#5b7f95", "#8f8a7a", "#b23a2e", "#e0c56a", "#463057",
        )
    ]
)  # fmt: skip


def _pick(table: Array, share: Array) -> Array:
    return table[np.minimum((share * len(table)).astype(np.int64), len(table) - 1)]


def poster(spots: Spots, colour: Colour) -> Coat:
    """A printed sheet: headline, picture, columns of text, white margin."""
    u, v = spots.u / spots.w, spots.v / spots.h
    soft = spots.blur / spots.h
    seed = spots.seed
    picture = band(u, 0.10, 0.90, soft) * band(v, 0.34, 0.76, soft)
    image = noise(np.stack([u, v, (seed % 61).astype(np.float64)], axis=1), 0.28, 501)
    sketch = blend(
        tint(colour, 0.5 * image), linear("#f0e3c0"), step(image, 0.15, np.full(len(spots), 0.3))
    )
    text = (
        band(u, 0.10, 0.90, soft)
        * band(v, 0.08, 0.28, soft)
        * pulse(v, 0.036, 0.018, soft)
        * (hashed(503, seed, np.floor(v / 0.036), np.floor(u / 0.09)) > 0.2)
    )
    head = band(u, 0.10, 0.72, soft) * band(v, 0.82, 0.91, soft)
    albedo = np.broadcast_to(linear("#e9e6df"), (len(spots), 3))
    albedo = blend(albedo, sketch, picture)
    albedo = blend(albedo, linear("#55565a"), 0.8 * text)
    return Coat(albedo=blend(albedo, colour * 0.8, head))


def mural(spots: Spots, colour: Colour) -> Coat:
    """A spray-painted wall: illegible letters, outlined."""
    u, v = spots.u / spots.h, spots.v / spots.h
    field = noise(np.stack([u, v * 0.8], axis=1), 0.33, 511) + 0.4 * noise(
        np.stack([u, v], axis=1), 0.13, 513
    )
    soft = np.full(len(spots), 0.08) + spots.blur
    fill = step(field, -0.05, soft)
    line = band(field, -0.16, -0.02, soft)
    shade = step(field, 0.35, soft)
    edge = 1.0 - frame(spots.u, spots.v, spots.w, spots.h, 0.06, spots.blur + 0.05)
    albedo = np.broadcast_to(linear("#c7b9a4"), (len(spots), 3))
    albedo = blend(albedo, colour, fill * edge)
    albedo = blend(albedo, linear("#e7a23c"), 0.85 * shade * edge)
    return Coat(albedo=blend(albedo, linear("#1f1c22"), line * edge))


def whiteboard(spots: Spots, colour: Colour) -> Coat:
    """A whiteboard with formulas, a sketch and a tray."""
    rim = frame(spots.u, spots.v, spots.w, spots.h, 0.025, spots.blur)
    line = np.floor(spots.v / 0.12)
    ends = 0.25 + 0.5 * hashed(521, line)
    wave = 0.02 * noise(np.stack([spots.u, line * 3.0], axis=1), 0.03, 523)
    ink = (
        band((spots.v % 0.12) + wave, 0.045, 0.062, spots.blur)
        * band(spots.u, 0.15, ends * spots.w, spots.blur)
        * band(spots.v, 0.3, spots.h - 0.12, spots.blur)
    )
    ring = np.abs(np.hypot(spots.u - 0.76 * spots.w, spots.v - 0.55 * spots.h) - 0.2)
    circle = np.clip(1.0 - ring / (0.012 + spots.blur * 0.5), 0.0, 1.0)
    albedo = tint(colour, -0.05 * fractal(spots.p, 0.4, 525, octaves=3, blur=spots.blur))
    albedo = blend(albedo, linear("#1d3f86"), 0.85 * ink)
    albedo = blend(albedo, linear("#a5271f"), 0.8 * circle)
    return Coat(albedo=blend(albedo, linear("#a9acae"), rim))


def pinboard(spots: Spots, colour: Colour) -> Coat:
    """A cork board covered with sheets of paper."""
    column, row = np.floor(spots.u / 0.27), np.floor(spots.v / 0.33)
    there = hashed(531, spots.seed, column, row) > 0.25
    du = spots.u - column * 0.27 - 0.04 * hashed(533, column, row)
    dv = spots.v - row * 0.33 - 0.04 * hashed(535, column, row)
    sheet = there * band(du, 0.01, 0.21, spots.blur) * band(dv, 0.01, 0.28, spots.blur)
    paper = blend(
        np.broadcast_to(linear("#e8e6df"), (len(spots), 3)),
        _pick(_BOOKS, hashed(537, column, row)),
        0.35 * (hashed(539, column, row) > 0.6),
    )
    text = pulse(dv, 0.03, 0.013, spots.blur) * band(du, 0.03, 0.18, spots.blur)
    paper = tint(paper, -0.45 * text)
    rim = frame(spots.u, spots.v, spots.w, spots.h, 0.03, spots.blur)
    cork = tint(colour, 0.2 * fractal(spots.p, 0.05, 541, octaves=2, blur=spots.blur * 0.5))
    inside = band(spots.u, 0.04, spots.w - 0.04, spots.blur) * band(
        spots.v, 0.04, spots.h - 0.04, spots.blur
    )
    return Coat(albedo=blend(blend(cork, paper, sheet * inside), linear("#8a6a45"), rim))


def books(spots: Spots, colour: Colour) -> Coat:
    """A row of book spines of different heights in a dark compartment."""
    width = 0.042
    index = np.floor(spots.u / width)
    row = np.floor(spots.p[:, 2] / 0.1)
    tall = (0.72 + 0.26 * hashed(551, spots.seed, index, row * 0)) * spots.h
    there = hashed(553, spots.seed, np.floor(index / 5), 3) > 0.12
    spine = there * (1.0 - step(spots.v, tall, spots.blur))
    edge = pulse(spots.u, width, 0.005, spots.blur)
    label = band(spots.v / spots.h, 0.45, 0.60, spots.blur / spots.h) * (
        hashed(555, spots.seed, index) > 0.5
    )
    cover = tint(_pick(_BOOKS, hashed(557, spots.seed, index)), -0.5 * edge)
    cover = blend(cover, linear("#e2d9b8"), 0.6 * label)
    return Coat(albedo=blend(np.broadcast_to(colour * 0.25, (len(spots), 3)), cover, spine))


def pegboard(spots: Spots, colour: Colour) -> Coat:
    """A board with hanging tools."""
    column, row = np.floor(spots.u / 0.19), np.floor(spots.v / 0.38)
    u = spots.u - column * 0.19 - 0.095
    v = spots.v - row * 0.38
    reach = 0.10 + 0.20 * hashed(561, spots.seed, column, row)
    thick = 0.010 + 0.014 * hashed(563, column, row)
    shaft = band(u, -thick, thick, spots.blur) * band(v, 0.34 - reach, 0.32, spots.blur)
    head = band(u, -2.6 * thick, 2.6 * thick, spots.blur) * band(v, 0.27, 0.33, spots.blur)
    grip = band(u, -1.5 * thick, 1.5 * thick, spots.blur) * band(
        v, 0.34 - reach, 0.40 - reach, spots.blur
    )
    inside = band(spots.u, 0.05, spots.w - 0.05, spots.blur)
    holes = pulse(spots.u, 0.04, 0.008, spots.blur) * pulse(spots.v, 0.04, 0.008, spots.blur)
    albedo = tint(colour, -0.6 * holes)
    albedo = blend(albedo, linear("#6d7276"), np.clip(shaft + head, 0.0, 1.0) * inside)
    handle = _pick(_BOOKS, hashed(565, column, row)) * 1.2
    albedo = blend(albedo, handle, grip * inside)
    rim = frame(spots.u, spots.v, spots.w, spots.h, 0.03, spots.blur)
    return Coat(albedo=blend(albedo, linear("#4a3a2a"), rim))


def sign(spots: Spots, colour: Colour) -> Coat:
    """A room's number beside its door."""
    text = pulse(spots.v, 0.04, 0.02, spots.blur) * band(spots.u, 0.02, spots.w - 0.03, spots.blur)
    return Coat(albedo=blend(tint(colour, np.zeros(len(spots))), linear("#2b3a4a"), 0.7 * text))


def sign_board(spots: Spots, colour: Colour) -> Coat:
    """A shop's hanging sign."""
    disc = np.hypot(spots.u - spots.w / 2, spots.v - spots.h / 2) - 0.15
    mark = np.clip(1.0 - np.abs(disc) / (0.03 + spots.blur), 0.0, 1.0)
    return Coat(albedo=blend(tint(colour, np.zeros(len(spots))), linear("#e8d9a0"), mark))


def locker(spots: Spots, colour: Colour) -> Coat:
    """A steel locker: louvres above and below, a lock, a gap round its door."""
    gap = frame(spots.s, spots.t, spots.w, spots.h, 0.012, spots.blur)
    louvres = (
        pulse(spots.t, 0.035, 0.014, spots.blur)
        * band(spots.s, 0.25 * spots.w, 0.75 * spots.w, spots.blur)
        * (band(spots.t, 1.42, 1.62, spots.blur) + band(spots.t, 0.15, 0.30, spots.blur))
    )
    lock = band(spots.s, 0.80 * spots.w, 0.88 * spots.w, spots.blur) * band(
        spots.t, 0.85, 1.0, spots.blur
    )
    tone = 0.10 * (2.0 * hashed(571, spots.seed) - 1.0)
    albedo = tint(colour, tone - 0.65 * gap - 0.5 * np.clip(louvres, 0.0, 1.0))
    return Coat(albedo=blend(albedo, linear("#c5c7c8"), lock))


def wall_bars(spots: Spots, colour: Colour) -> Coat:
    """Gymnasium wall bars: rungs and uprights before a wall."""
    rung = pulse(spots.v, 0.15, 0.045, spots.blur)
    post = pulse(spots.u + 0.03, 0.90, 0.07, spots.blur)
    wall = np.broadcast_to(linear("#cfc8b8") * 0.75, (len(spots), 3))
    shadow = pulse(spots.v + 0.04, 0.15, 0.04, spots.blur)
    wood = tint(colour, 0.1 * fractal(spots.p, 0.3, 581, octaves=3, blur=spots.blur))
    return Coat(albedo=blend(tint(wall, -0.4 * shadow), wood, np.maximum(rung, post)))


def extinguisher(spots: Spots, colour: Colour) -> Coat:
    """A fire cabinet with its sign."""
    rim = frame(spots.s, spots.t, spots.w, spots.h, 0.03, spots.blur)
    mark = band(spots.s, 0.3 * spots.w, 0.7 * spots.w, spots.blur) * band(
        spots.t, 0.55 * spots.h, 0.85 * spots.h, spots.blur
    )
    albedo = blend(tint(colour, -0.3 * rim), np.full(3, 0.75), mark)
    return Coat(albedo=albedo)


def radiator(spots: Spots, colour: Colour) -> Coat:
    """Ribs of a radiator."""
    rib = pulse(spots.u, 0.05, 0.022, spots.blur)
    return Coat(albedo=tint(colour, -0.42 * rib))


def wheel(spots: Spots, colour: Colour) -> Coat:
    """A wheel in its arch, within a flank of the car's colour."""
    u, v = spots.s - spots.w / 2, spots.t - 0.14
    radius = np.hypot(u, v)
    flank = step(radius, 0.365, spots.blur)
    tyre = 1.0 - step(radius, 0.315, spots.blur)
    hub = 1.0 - step(radius, 0.20, spots.blur)
    angle = same_bits.arctan2(v, u)
    spoke = np.clip(np.abs(((angle / (2 * np.pi) * 5) % 1.0) - 0.5) * 4 - 0.6, 0.0, 1.0)
    albedo = np.broadcast_to(np.full(3, 0.006), (len(spots), 3))
    albedo = blend(albedo, np.full(3, 0.022), tyre)
    albedo = blend(albedo, linear("#9a9da1"), hub * (0.35 + 0.65 * spoke))
    return Coat(albedo=blend(albedo, car_paint(spots, colour).albedo, flank))


def dark_glass(spots: Spots, colour: Colour) -> Coat:
    """Panes of a car: dark, with a little of the sky in their upper part."""
    sky = np.array(spots.light.horizon) * 0.05
    up = np.clip((spots.p[:, 2] - 0.9) / 0.5, 0.0, 1.0)
    return Coat(
        albedo=np.broadcast_to(colour, (len(spots), 3)).copy(), glow=sky * (0.3 + up)[:, None]
    )


def grille(spots: Spots, colour: Colour) -> Coat:
    """Bars of a radiator grille above a number plate."""
    bars = pulse(spots.v, 0.05, 0.018, spots.blur)
    plate = band(spots.u, 0.5 * spots.w - 0.26, 0.5 * spots.w + 0.26, spots.blur) * band(
        spots.v, 0.0, 0.11, spots.blur
    )
    albedo = blend(np.full((len(spots), 3), 0.01), colour, 0.6 * bars)
    return Coat(albedo=blend(albedo, np.full(3, 0.7), plate))
