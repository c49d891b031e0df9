"""Light on surfaces: sun, lamps and sky with shadows, and light that walls pass on.

The sky is what a ray that meets nothing sees, and a dome of Gaussians that shows it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_places.bake.openings import casement, steel_frame
from nw_places.bake.spots import Array, fractal
from nw_places.bake.surfels import (
    Cells,
    Frames,
    decal_at,
    dot,
    frames,
    length,
    paint,
    position,
)
from nw_places.places.crowns import crown_mesh
from nw_places.places.parts import Light, Place
from nw_scenes.mesh import merge, quad_mesh
from nw_scenes.rays import RayScene

# Rays start this far off their surface, metres.
_OFF = 0.006
_CHUNK = 16384
_SUN_RAYS = 4
# The sun's own radius is 0.0047 rad; haze and lens make shadows a little softer.
_SUN_SPREAD = 0.010
# Sets of directions that points take in turn, and the directions in a set.
_SETS = 61
_MOST_RAYS = 32
# Side of the cells in which light that surfaces pass on is kept, metres; most cells of a patch.
_STORE_CELL = 0.6
_STORE_MOST = 40


@dataclass(frozen=True, kw_only=True, eq=False)
class _Stored:
    """What surfaces send back, on a coarse grid of each patch."""

    first: NDArray[np.int64]
    count_u: NDArray[np.int64]
    count_v: NDArray[np.int64]
    radiance: Array


class Lighting:
    """Answers how much light falls on points of one scene."""

    def __init__(self, place: Place) -> None:
        self.place = place
        self.geometry: Frames = frames(place.patches)
        quads = [quad_mesh(p.origin, p.u, p.v, p.kind or "ground") for p in place.patches]
        crowns = [crown_mesh(crown) for crown in place.crowns]
        self._rays = RayScene(merge([*quads, *crowns]))
        self._patch_faces = 2 * len(place.patches)
        self._sun = sun_direction(place.light)
        self._sun_colour = np.array(place.light.sun_colour)
        self._sets = _hemispheres(_MOST_RAYS)
        self._openings = {
            index for index, p in enumerate(place.patches) if any(d.opening for d in p.decals)
        }
        crown_albedo = np.array([0.035, 0.055, 0.018])
        self._crown_radiance = crown_albedo * (
            0.5 * self._sun_colour + np.array(place.light.zenith)
        )
        self._stored = self._store()

    def passed_on(self, points: Array, normals: Array, rays: int) -> Array:
        """Return the light from sky and surfaces: what a white surface would send back.

        Args:
            points: (N, 3) metres.
            normals: (N, 3) unit vectors.
            rays: into the hemisphere, at most 32; few rays make it grainy, see `smoothed`.

        Returns:
            (N, 3) linear radiance, without sun and lamps.
        """
        result = np.empty((len(points), 3))
        for start in range(0, len(points), _CHUNK):
            part = slice(start, start + _CHUNK)
            result[part] = self._gather(points[part], normals[part], rays)
        return result

    def direct(self, points: Array, normals: Array) -> Array:
        """Return sun and lamps on points, (N, 3)."""
        light = np.zeros((len(points), 3))
        facing = dot(normals, self._sun)
        lit = np.flatnonzero(facing > 0.0)
        if len(lit) and max(self.place.light.sun_colour) > 0.0:
            seen = self.sun_seen(points[lit] + _OFF * normals[lit])
            light[lit] += (facing[lit] * seen)[:, None] * self._sun_colour
        for index in range(len(self.place.lamps)):
            light += self._lamp(index, points, normals)
        return light

    def sun_seen(self, points: Array) -> Array:
        """Return the share of the sun that points (N, 3) see, 0 to 1."""
        across = np.cross(self._sun, [0.0, 0.0, 1.0])
        across = across / length(across[None])[0]
        upward = np.cross(across, self._sun)
        total = np.zeros(len(points))
        for ray in range(_SUN_RAYS):
            # A different place on the sun for each ray; all points share them, as in a photograph.
            angle = 2.0 * np.pi * (ray + 0.5) / _SUN_RAYS
            radius = _SUN_SPREAD * (0.45 + 0.55 * (ray % 2))
            way = self._sun + radius * (np.cos(angle) * across + np.sin(angle) * upward)
            way = way / length(way[None])[0]
            total += self._passes(points, np.broadcast_to(way, points.shape))
        return total / _SUN_RAYS

    def _passes(self, points: Array, ways: Array) -> Array:
        """Return how much of the sun's ray comes through, 0 to 1 for each point."""
        distance, face = self._rays.cast(points, ways)
        through = (face < 0).astype(np.float64)
        leaf = np.flatnonzero(face >= self._patch_faces)
        if len(leaf):
            # Crowns let spots of light through.
            spots = fractal(points[leaf] + ways[leaf] * 0.7, 0.34, 701, octaves=2)
            through[leaf] = np.clip((spots - 0.18) * 4.0, 0.0, 1.0) * 0.85
        for patch in self._openings:
            mine = np.flatnonzero(face >> 1 == patch)
            if len(mine):
                hit = points[mine] + distance[mine, None] * ways[mine]
                through[mine] = self._through_opening(patch, hit)
        return through

    def _through_opening(self, patch: int, hits: Array) -> Array:
        part = self.place.patches[patch]
        apart = hits - self.geometry.origin[patch]
        s = dot(apart, self.geometry.axis_u[patch])
        t = dot(apart, self.geometry.axis_v[patch])
        which = decal_at(part, s, t)
        passed = np.zeros(len(hits))
        blur = np.full(len(hits), 0.015)
        for index, decal in enumerate(part.decals):
            mine = which == index
            if not decal.opening or not mine.any():
                continue
            u0, v0, u1, v1 = decal.rect
            bars = steel_frame if decal.material.startswith("steel") else casement
            w, h = np.full(mine.sum(), u1 - u0), np.full(mine.sum(), v1 - v0)
            passed[mine] = 1.0 - bars(s[mine] - u0, t[mine] - v0, w, h, blur[mine])
        return passed

    def _lamp(self, index: int, points: Array, normals: Array) -> Array:
        lamp = self.place.lamps[index]
        u, v, origin = np.array(lamp.u), np.array(lamp.v), np.array(lamp.origin)
        normal = np.cross(u, v)
        area = float(length(normal[None])[0])
        normal = normal / area
        total = np.zeros(len(points))
        starts = points + _OFF * normals
        for a, b in ((0.28, 0.31), (0.74, 0.69)):
            way = origin + a * u + b * v - starts
            square = np.maximum(dot(way, way), 1e-6)
            apart = np.sqrt(square)
            way = way / apart[:, None]
            shine = np.maximum(dot(normals, way), 0.0) * np.maximum(-dot(normal, way), 0.0)
            # Near a lamp a single sample would overshoot; half its area softens that.
            weight = shine * area / (np.pi * (square + 0.5 * area / np.pi))
            ask = np.flatnonzero(weight > 1e-4)
            free = np.zeros(len(points))
            if len(ask):
                distance = self._rays.distance(starts[ask], way[ask])
                free[ask] = distance > apart[ask] - 0.03
            total += 0.5 * weight * free
        return total[:, None] * np.array(lamp.radiance)

    def _gather(self, points: Array, normals: Array, rays: int) -> Array:
        """Return the mean radiance that comes from all sides, weighted by its slant."""
        count = len(points)
        chosen = (np.floor(points / 0.013).astype(np.int64) * np.array([3, 7, 13])).sum(
            axis=1
        ) % _SETS
        local = self._sets[chosen][:, :rays]
        one, two = _tangents(normals)
        ways = (
            local[..., :1] * one[:, None] + local[..., 1:2] * two[:, None]
            + local[..., 2:] * normals[:, None]
        ).reshape(-1, 3)  # fmt: skip
        starts = np.repeat(points + _OFF * normals, rays, axis=0)
        distance, face = self._rays.cast(starts, ways)
        return self._seen(starts, ways, distance, face).reshape(count, rays, 3).mean(axis=1)

    def _seen(self, starts: Array, ways: Array, distance: Array, face: NDArray[np.int32]) -> Array:
        """Return the radiance that rays see, (N, 3)."""
        seen = np.zeros((len(ways), 3))
        missed = np.flatnonzero(face < 0)
        if not self.place.indoor:
            sky = sky_radiance(ways[missed], self.place.light, clouds=False)
            below = ways[missed, 2] < 0.0
            sky[below] = 0.18 * (
                self._sun_colour * self._sun[2] + np.array(self.place.light.zenith)
            )
            seen[missed] = sky
        seen[face >= self._patch_faces] = self._crown_radiance
        walls = np.flatnonzero((face >= 0) & (face < self._patch_faces))
        stored = self._stored
        patch = face[walls].astype(np.int64) >> 1
        # The inside of a box's back shows nothing.
        front = dot(self.geometry.normal[patch], ways[walls]) < 0.0
        walls, patch = walls[front], patch[front]
        apart = starts[walls] + distance[walls, None] * ways[walls] - self.geometry.origin[patch]
        g = self.geometry
        cell_u = dot(apart, g.axis_u[patch]) / g.width[patch] * stored.count_u[patch]
        cell_v = dot(apart, g.axis_v[patch]) / g.height[patch] * stored.count_v[patch]
        column = np.clip(cell_u.astype(np.int64), 0, stored.count_u[patch] - 1)
        row = np.clip(cell_v.astype(np.int64), 0, stored.count_v[patch] - 1)
        seen[walls] = stored.radiance[stored.first[patch] + column * stored.count_v[patch] + row]
        return seen

    def _store(self) -> _Stored:
        """Return what surfaces send back after a few bounces."""
        g = self.geometry
        count_u = np.clip(np.ceil(g.width / _STORE_CELL), 1, _STORE_MOST).astype(np.int64)
        count_v = np.clip(np.ceil(g.height / _STORE_CELL), 1, _STORE_MOST).astype(np.int64)
        total = count_u * count_v
        first = np.concatenate([[0], np.cumsum(total)[:-1]])
        patch = np.repeat(np.arange(len(total)), total)
        inner = np.arange(int(total.sum())) - first[patch]
        s = (inner // count_v[patch] + 0.5) / count_u[patch] * g.width[patch]
        t = (inner % count_v[patch] + 0.5) / count_v[patch] * g.height[patch]
        decal = np.full(len(patch), -1, dtype=np.int64)
        for index, part in enumerate(self.place.patches):
            if part.decals:
                mine = slice(first[index], first[index] + total[index])
                decal[mine] = decal_at(part, s[mine], t[mine])
        cells = Cells(
            patch=patch,
            decal=decal,
            s=s,
            t=t,
            width=(g.width / count_u)[patch],
            height=(g.height / count_v)[patch],
            rim=np.zeros((len(patch), 4), dtype=bool),
        )
        albedo, _ = paint(self.place.patches, g, cells, self.place.light)
        painted = np.array([part.painted for part in self.place.patches])
        albedo[~painted[patch]] = 0.0
        points, normals = position(cells, g), g.normal[patch]
        direct = self.direct(points, normals)
        radiance = albedo * direct
        for _ in range(3 if self.place.indoor else 2):
            self._stored = _Stored(first=first, count_u=count_u, count_v=count_v, radiance=radiance)
            radiance = albedo * (direct + self._gather(points, normals, _MOST_RAYS))
        return _Stored(first=first, count_u=count_u, count_v=count_v, radiance=radiance)


def smoothed(cells: Cells, values: Array) -> Array:
    """Return values (N, 3) averaged over some neighbours on the same patch, for grain to vanish.

    Four grids of squares, each moved against the others, stand in for a soft kernel; a square is
    about six cells wide.
    """
    size = np.sqrt(cells.width * cells.height)
    _, exponent = np.frexp(size)
    side = np.ldexp(4.0, exponent)
    total = np.zeros_like(values)
    for shift_s, shift_t in ((0.0, 0.0), (0.5, 0.25), (0.25, 0.75), (0.75, 0.5)):
        column = np.floor(cells.s / side + shift_s).astype(np.int64)
        row = np.floor(cells.t / side + shift_t).astype(np.int64)
        key = ((cells.patch * 64 + exponent + 32) << 34) + (column << 17) + row
        _, square = np.unique(key, return_inverse=True)
        count = np.bincount(square)
        for channel in range(3):
            mean = np.bincount(square, weights=values[:, channel]) / count
            total[:, channel] += mean[square]
    return total / 4.0


def _tangents(normals: Array) -> tuple[Array, Array]:
    """Return two unit vectors across each normal."""
    helper = np.where(np.abs(normals[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    one = np.cross(helper, normals)
    one = one / length(one)[:, None]
    return one, np.cross(normals, one)


def _hemispheres(rays: int) -> Array:
    """Return sets of directions about +z, spread evenly and denser near it, (SETS, rays, 3)."""
    generator = np.random.Generator(np.random.PCG64(20250))
    index = np.arange(rays)
    shift = generator.random((_SETS, 2))
    share = (index[None] * 0.7548776662466927 + shift[:, :1]) % 1.0
    turn = (index[None] * 0.5698402909980532 + shift[:, 1:]) % 1.0
    radius = np.sqrt(share)
    return np.stack(
        [
            radius * np.cos(2 * np.pi * turn),
            radius * np.sin(2 * np.pi * turn),
            np.sqrt(np.maximum(1.0 - share, 1e-4)),
        ],
        axis=-1,
    )


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
