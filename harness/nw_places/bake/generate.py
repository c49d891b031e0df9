"""A scene's Gaussians, made from its geometry, paint and light.

Radiance becomes what a camera's picture shows.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from nw_base import same_bits
from nw_places.bake.foliage import Tufts, blades, leaves, quats_from_normals
from nw_places.bake.lighting import Lighting, dome, sky_radiance, smoothed
from nw_places.bake.spots import Array
from nw_places.bake.surfels import Cells, Frames, cut, eye_distance, frames, paint, position
from nw_places.places.parts import Patch, Place
from nw_scenes.scene import Vector
from nw_splat.gaussians import SH0, Gaussians

if TYPE_CHECKING:
    from nw_scenes.scene import Progress


# Gaussians that a scene should have, about; and those of its sky.
_BUDGET = 185_000
_SKY = 5000
_SKY_RADIUS = 90.0
# Standard deviation of a disc in parts of its cell, and its thickness in the same.
_SPREAD = 0.55
_THICKNESS = 0.07
_OPACITY = 0.985
# The layers of lining: how much coarser than the surface, and spread in parts of a cell.
_LINING = ((3.5, 0.66), (5.0, 0.80))
# Metres behind the surface in parts of a cell. Discs are drawn in the order of their middles: on a
# slanting surface, lining that lay closer would come before the surface it lines.
_LINING_DEPTH = 1.1
# Metres that an obstacle's lining keeps within its edges.
_LINING_INSET = 0.02
# Narrower decals, metres, are left out of the lining.
_LINED_DECAL = 0.4

_LUMA = np.array([0.2126, 0.7152, 0.0722])
# What the middle of the picture is exposed to, before the tone curve, indoors and outdoors.
_MIDDLE_GREY = {True: 0.17, False: 0.24}

# How far automatic white balance goes towards grey, 0 to 1.
_WHITE_BALANCE = 0.55


def generate(place: Place, progress: Progress | None = None, *, budget: int = _BUDGET) -> Gaussians:
    """Return the Gaussians of a scene; the same bytes for the same scene.

    Args:
        place: what to build.
        progress: called with a stage's name and the share done.
        budget: about as many Gaussians lie on surfaces and lawns; leaves and sky come on top.
    """

    def report(stage: str, share: float) -> None:
        if progress is not None:
            progress(stage, share)

    seed = int.from_bytes(hashlib.sha256(place.name.encode()).digest()[:16], "little")
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed)))
    report("geometry", 0.0)
    geometry = frames(place.patches)
    coarseness = _coarseness(place, budget)
    cells = cut(place.patches, geometry, place.eyes, coarseness)
    tufts = leaves(place.crowns, place.eyes, coarseness, rng)
    for lawn in place.lawns:
        tufts.append(blades(lawn, *_lawn_cells(place, lawn.rect, coarseness), rng))
    report("paint", 0.15)
    albedo, glow = paint(place.patches, geometry, cells, place.light)
    report("light", 0.25)
    lighting = Lighting(place)
    points, normals = position(cells, geometry), geometry.normal[cells.patch]
    fallen = np.empty_like(albedo)
    step = 32768
    for start in range(0, len(cells), step):
        part = slice(start, start + step)
        fallen[part] = lighting.passed_on(points[part], normals[part], 28)
        report("light", 0.3 + 0.5 * min(1.0, (start + step) / max(len(cells), 1)))
    fallen = smoothed(cells, smoothed(cells, fallen)) + lighting.direct(points, normals)
    radiance = albedo * fallen + glow
    scale = exposure(place, points, fallen, radiance)
    # Cells at an edge keep to their line.
    loose = np.stack([~cells.rim[:, :2].any(axis=1), ~cells.rim[:, 2:].any(axis=1)], axis=1)
    jitter = 0.30 * (rng.random((len(cells), 2)) - 0.5) * loose
    parts = [
        _gaussians(
            points
            + geometry.axis_u[cells.patch] * (jitter[:, :1] * cells.width[:, None])
            + geometry.axis_v[cells.patch] * (jitter[:, 1:] * cells.height[:, None]),
            np.stack(
                [
                    _SPREAD * cells.width,
                    _SPREAD * cells.height,
                    _THICKNESS * np.minimum(cells.width, cells.height) + 0.0004,
                ],
                axis=1,
            ),
            _quats(geometry)[cells.patch],
            np.full(len(cells), _OPACITY),
            display(_fogged(place, points, radiance), scale),
        )
    ]
    parts.extend(_lining(place, coarseness, lighting, scale))
    for index, tuft in enumerate(tufts):
        parts.append(_lit_tufts(place, lighting, tuft, scale))
        report("leaves", 0.8 + 0.15 * (index + 1) / len(tufts))
    parts.append(_surround(place, scale, radiance, points))
    return _joined(parts)


def _lining(
    place: Place, coarseness: float, lighting: Lighting, scale: Array
) -> Iterator[Gaussians]:
    """Return coarse discs behind large surfaces, in two layers.

    A twentieth of a camera's ray passes between the fine discs. What it meets should be of the
    same colour and nearly as far away: a thousandth that went on to the sky would spoil depth.
    """
    for layer, (coarser, spread) in enumerate(_LINING):
        lined = [_lined(patch, layer) for patch in place.patches]
        geometry = frames(lined)
        cells = cut(lined, geometry, place.eyes, coarser * coarseness)
        albedo, glow = paint(lined, geometry, cells, place.light)
        points, normals = position(cells, geometry), geometry.normal[cells.patch]
        fallen = lighting.passed_on(points, normals, 16) + lighting.direct(points, normals)
        sizes = np.stack([cells.width, cells.height], axis=1)
        depth = _LINING_DEPTH * sizes.max(axis=1) * (1 + layer)
        thin = np.array([_thin(patch) for patch in lined])[cells.patch]
        depth = np.minimum(depth, thin)[:, None]
        yield _gaussians(
            points - depth * normals,
            np.concatenate([spread * sizes, np.full((len(cells), 1), 0.004)], axis=1),
            _quats(geometry)[cells.patch],
            np.full(len(cells), _OPACITY),
            display(_fogged(place, points, albedo * fallen + glow), scale),
        )


def _lined(patch: Patch, layer: int) -> Patch:
    """Return what is lined of a patch: an obstacle's is drawn in, so that edges stay sharp."""
    size = min(sum(part * part for part in edge) ** 0.5 for edge in (patch.u, patch.v))
    if patch.kind == "obstacle":
        # The lining of a board's underside would come out above the board.
        if layer > 0 or _looks_down(patch):
            return replace(patch, painted=False)
        share = min(_LINING_INSET / size, 0.4)
        inset = tuple(
            o + share * size * (u / _norm(patch.u) + v / _norm(patch.v))
            for o, u, v in zip(patch.origin, patch.u, patch.v, strict=True)
        )
        u, v = (
            tuple(part * (1.0 - 2.0 * share * size / _norm(edge)) for part in edge)
            for edge in (patch.u, patch.v)
        )
        return replace(patch, origin=inset, u=u, v=v)
    large = tuple(
        decal
        for decal in patch.decals
        if min(decal.rect[2] - decal.rect[0], decal.rect[3] - decal.rect[1]) > _LINED_DECAL
    )
    painted = patch.painted and patch.kind != "clutter" and size > 1.0
    return replace(patch, painted=painted, decals=large)


def _looks_down(patch: Patch) -> bool:
    return patch.u[0] * patch.v[1] - patch.u[1] * patch.v[0] < -1e-9


def _thin(patch: Patch) -> float:
    """Return how far behind a patch its lining may lie, metres."""
    return 0.05 if patch.kind == "obstacle" else math.inf


def _norm(edge: Vector) -> float:
    return math.sqrt(sum(part * part for part in edge))


def _quats(geometry: Frames) -> Array:
    """Return w x y z of the patches' own axes, (P, 4)."""
    m = np.stack([geometry.axis_u, geometry.axis_v, geometry.normal], axis=-1)
    candidates = np.stack(
        [
            np.stack([1 + m[:, 0, 0] + m[:, 1, 1] + m[:, 2, 2], m[:, 2, 1] - m[:, 1, 2],
                      m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]], axis=1),
            np.stack([m[:, 2, 1] - m[:, 1, 2], 1 + m[:, 0, 0] - m[:, 1, 1] - m[:, 2, 2],
                      m[:, 0, 1] + m[:, 1, 0], m[:, 0, 2] + m[:, 2, 0]], axis=1),
            np.stack([m[:, 0, 2] - m[:, 2, 0], m[:, 0, 1] + m[:, 1, 0],
                      1 - m[:, 0, 0] + m[:, 1, 1] - m[:, 2, 2], m[:, 1, 2] + m[:, 2, 1]], axis=1),
            np.stack([m[:, 1, 0] - m[:, 0, 1], m[:, 0, 2] + m[:, 2, 0],
                      m[:, 1, 2] + m[:, 2, 1], 1 - m[:, 0, 0] - m[:, 1, 1] + m[:, 2, 2]], axis=1),
        ],
        axis=1,
    )  # fmt: skip
    square = (candidates * candidates).sum(axis=2)
    best = square.argmax(axis=1)
    rows = np.arange(len(m))
    return candidates[rows, best] / np.sqrt(square[rows, best])[:, None]


def _coarseness(place: Place, budget: int) -> float:
    """Return the factor on sizes that brings surfaces and lawns to the budget."""
    geometry = frames(place.patches)
    factor = 1.0
    for _ in range(3):
        count = len(cut(place.patches, geometry, place.eyes, factor))
        count += sum(len(_lawn_cells(place, lawn.rect, factor)[0]) for lawn in place.lawns)
        if 0.97 * budget < count < 1.03 * budget:
            break
        factor *= float(np.clip(math.sqrt(count / budget), 0.5, 3.0))
    return factor


def _lawn_cells(
    place: Place, rect: tuple[float, float, float, float], coarseness: float
) -> tuple[Array, Array]:
    """Return where blades stand in a lawn, (N, 3), and the sizes of their cells, (N,)."""
    x0, y0, x1, y1 = rect
    bed = Patch(
        origin=(x0, y0, 0.0), u=(x1 - x0, 0.0, 0.0), v=(0.0, y1 - y0, 0.0), material="grass",
        fine=1.25,
    )  # fmt: skip
    geometry = frames([bed])
    cells: Cells = cut([bed], geometry, place.eyes, coarseness)
    return position(cells, geometry), np.sqrt(cells.width * cells.height)


def _fogged(place: Place, points: Array, radiance: Array) -> Array:
    if place.light.fog <= 0.0:
        return radiance
    away = eye_distance(points, place.eyes)
    share = np.clip(place.light.fog * away / 30.0, 0.0, 0.6)
    return radiance + (np.array(place.light.horizon) - radiance) * share[:, None]


def _lit_tufts(place: Place, lighting: Lighting, tufts: Tufts, scale: Array) -> Gaussians:
    fallen = lighting.passed_on(tufts.lit_at, tufts.normals, 10)
    fallen += lighting.direct(tufts.lit_at, tufts.normals)
    sun = np.array(place.light.sun_colour) * tufts.glow_through[:, None]
    radiance = tufts.albedo * (fallen * tufts.shade[:, None] + sun)
    return _gaussians(
        tufts.means,
        tufts.scales,
        tufts.quats,
        tufts.opacity,
        display(_fogged(place, tufts.means, radiance), scale),
    )


def _surround(place: Place, scale: Array, radiance: Array, points: Array) -> Gaussians:
    """Return the sky, and beneath the horizon what shows through gaps between discs."""
    middle = np.array([place.eyes[-1][0] / 2, 0.0, 0.0])
    directions, apart = dome(_SKY, -0.12)
    below, apart_below = dome(500, -1.0)
    below = below[below[:, 2] < -0.05]
    near = eye_distance(points, place.eyes) < 4.0
    mean = radiance[near].mean(axis=0) if near.any() else radiance.mean(axis=0)
    if place.indoor:
        colour = np.broadcast_to(mean, (len(directions), 3))
    else:
        colour = sky_radiance(directions, place.light, clouds=True)
    means = np.concatenate([directions, below]) * _SKY_RADIUS + middle
    spread = np.concatenate(
        [np.full(len(directions), 0.75 * apart), np.full(len(below), 0.9 * apart_below)]
    )
    wide = spread * _SKY_RADIUS
    return _gaussians(
        means,
        np.stack([wide, wide, 0.02 * wide], axis=1),
        quats_from_normals(-np.concatenate([directions, below]), np.zeros(len(means))),
        np.full(len(means), 0.99),
        display(np.concatenate([colour, np.broadcast_to(mean, (len(below), 3))]), scale),
    )


def _gaussians(means: Array, scales: Array, quats: Array, opacity: Array, rgb: Array) -> Gaussians:
    return Gaussians(
        means=means.astype(np.float32),
        log_scales=same_bits.log(scales).astype(np.float32),
        quats=quats.astype(np.float32),
        opacity_logits=same_bits.log(opacity / (1.0 - opacity)).astype(np.float32),
        sh=((rgb - 0.5) / SH0).astype(np.float32)[:, None, :],
    )


def _joined(parts: Sequence[Gaussians]) -> Gaussians:
    return replace(
        parts[0],
        **{
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in ("means", "log_scales", "quats", "opacity_logits", "sh")
        },
    )


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
    gain = same_bits.power(float((white * _LUMA).sum()) / np.maximum(white, 1e-4), _WHITE_BALANCE)
    luma = (radiance[near] * gain * _LUMA).sum(axis=1)
    grey = _MIDDLE_GREY[place.indoor] * place.light.exposure
    return gain * grey / max(float(np.median(luma)), 1e-4)


def display(radiance: Array, scale: Array) -> Array:
    """Return sRGB values 0 to 1 of linear radiance (N, 3), through a film-like curve."""
    x = np.maximum(radiance * scale, 0.0)
    # Reinhard's curve with a white point: a long shoulder, so that windows do not burn out hard.
    curve = np.clip(1.05 * x * (1.0 + x / 12.0) / (1.0 + x), 0.0, 1.0)
    # A film's contrast: darker shadows, brighter lights.
    shown = np.where(
        curve <= 0.0031308, 12.92 * curve, 1.055 * same_bits.power(curve, 1 / 2.4) - 0.055
    )
    return np.clip(shown + 0.35 * shown * (1.0 - shown) * (shown - 0.5), 0.0, 1.0)
