"""Surfaces cut into cells, fine where the robot's eye comes near, coarse far away; and their paint.

Each material is asked once for all the cells that it covers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_places.bake.materials import coat
from nw_places.bake.spots import Array, Spots
from nw_places.places.parts import Light, Patch
from nw_scenes.scene import Vector

# A cell is about this many metres wide for each metre between it and the eye's path ...
_ANGLE = 0.017
# ... but never finer than this, nor coarser than that.
_FINEST = 0.012
_COARSEST = 2.5
# Cells that end at an edge are this much narrower, so that they do not bleed across it.
_RIM = 0.5
# Surfaces that look away from the whole trail are only seen by people.
_AWAY = 2.2


@dataclass(frozen=True, kw_only=True, eq=False)
class Frames:
    """The patches' geometry as arrays, P patches.

    Attributes:
        origin, u, v: (P, 3) metres.
        width, height: (P,) lengths of the edges.
        axis_u, axis_v, normal: (P, 3) orthonormal.
    """

    origin: Array
    u: Array
    v: Array
    width: Array
    height: Array
    axis_u: Array
    axis_v: Array
    normal: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Cells:
    """N cells of patches.

    Attributes:
        patch: (N,) int64 index of the patch.
        decal: (N,) int64 index of the patch's decal that covers the cell, -1 for none.
        s, t: (N,) metres from the patch's corner to the cell's middle.
        width, height: (N,) metres.
        rim: (N, 4) whether the cell ends at an edge of its patch or decal: at small and large s,
            at small and large t.
    """

    patch: NDArray[np.int64]
    decal: NDArray[np.int64]
    s: Array
    t: Array
    width: Array
    height: Array
    rim: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.patch)


def frames(patches: Sequence[Patch]) -> Frames:
    """Return the geometry of patches as arrays."""
    origin = np.array([patch.origin for patch in patches]).reshape(-1, 3)
    u = np.array([patch.u for patch in patches]).reshape(-1, 3)
    v = np.array([patch.v for patch in patches]).reshape(-1, 3)
    width, height = length(u), length(v)
    normal = np.cross(u, v)
    normal = normal / length(normal)[:, None]
    axis_u = u / width[:, None]
    return Frames(
        origin=origin,
        u=u,
        v=v,
        width=width,
        height=height,
        axis_u=axis_u,
        axis_v=np.cross(normal, axis_u),
        normal=normal,
    )


def length(vectors: Array) -> Array:
    """Return the lengths of (N, 3) vectors, by exact operations only."""
    return np.sqrt(dot(vectors, vectors))


def dot(one: Array, two: Array) -> Array:
    """Return the scalar products of (N, 3) vectors; BLAS might round otherwise elsewhere."""
    return one[..., 0] * two[..., 0] + one[..., 1] * two[..., 1] + one[..., 2] * two[..., 2]


def eye_distance(points: Array, eyes: Sequence[Vector]) -> Array:
    """Return the distance of points (N, 3) from the polyline through `eyes`, metres."""
    best = np.full(len(points), np.inf)
    path = np.array(eyes)
    for start, end in pairwise(path):
        along = end - start
        total = float(along[0] ** 2 + along[1] ** 2 + along[2] ** 2)
        share = np.clip(dot(points - start, along) / max(total, 1e-12), 0.0, 1.0)
        apart = points - (start + share[:, None] * along)
        best = np.minimum(best, dot(apart, apart))
    return np.sqrt(best)


def cut(
    patches: Sequence[Patch], geometry: Frames, eyes: Sequence[Vector], coarseness: float
) -> Cells:
    """Cut the painted patches into cells.

    First along the edges of decals, so that these stay sharp; then in halves until a cell is as
    small as its distance from the eye's path asks.

    Args:
        patches: what to cut; those that are not painted give no cells.
        geometry: of the patches.
        eyes: the path that a robot's eye takes.
        coarseness: multiplies all sizes, to meet a budget of cells.
    """
    current = _decal_cells(patches)
    fine = np.array([patch.fine for patch in patches])
    decal_fine = _decal_table(patches)
    done: list[Cells] = []
    while len(current):
        middle = position(current, geometry)
        reach = 0.5 * np.sqrt(current.width**2 + current.height**2)
        near = np.maximum(eye_distance(middle, eyes) - reach, 0.0)
        wanted = np.clip(_ANGLE * near, _FINEST, _COARSEST) * coarseness * fine[current.patch]
        wanted = wanted * decal_fine[current.patch, current.decal]
        wanted = np.where(_looks_away(current, geometry, middle, eyes), wanted * _AWAY, wanted)
        rim_s = current.rim[:, 0] | current.rim[:, 1]
        rim_t = current.rim[:, 2] | current.rim[:, 3]
        over_u = current.width / (wanted * np.where(rim_s, _RIM, 1.0))
        over_v = current.height / (wanted * np.where(rim_t, _RIM, 1.0))
        split_u = (over_u > 1.4) & (over_u >= over_v)
        split_v = (over_v > 1.4) & ~split_u
        stay = ~(split_u | split_v)
        done.append(_select(current, stay))
        current = _halves(current, split_u, split_v)
    return _join(done)


def position(cells: Cells, geometry: Frames) -> Array:
    """Return the middles of cells, (N, 3) metres."""
    p = cells.patch
    return (
        geometry.origin[p]
        + geometry.u[p] * (cells.s / geometry.width[p])[:, None]
        + geometry.v[p] * (cells.t / geometry.height[p])[:, None]
    )


def _decal_table(patches: Sequence[Patch]) -> Array:
    """Return (P, D + 1) the factor of each decal; the last column, index -1, is for none."""
    most = max((len(patch.decals) for patch in patches), default=0)
    table = np.ones((len(patches), most + 1))
    for index, patch in enumerate(patches):
        table[index, : len(patch.decals)] = [decal.fine for decal in patch.decals]
    return table


def _decal_cells(patches: Sequence[Patch]) -> Cells:
    """Return the painted patches cut along the edges of their decals."""
    geometry = frames(patches)
    parts: list[Cells] = []
    for index, patch in enumerate(patches):
        if not patch.painted:
            continue
        width, height = float(geometry.width[index]), float(geometry.height[index])
        across = _edges([edge for d in patch.decals for edge in (d.rect[0], d.rect[2])], width)
        along = _edges([edge for d in patch.decals for edge in (d.rect[1], d.rect[3])], height)
        s, t = (0.5 * (edges[1:] + edges[:-1]) for edges in (across, along))
        grid_s, grid_t = (grid.ravel() for grid in np.meshgrid(s, t, indexing="ij"))
        w, h = (
            grid.ravel() for grid in np.meshgrid(np.diff(across), np.diff(along), indexing="ij")
        )
        decal = decal_at(patch, grid_s, grid_t)
        parts.append(
            Cells(
                patch=np.full(len(grid_s), index),
                decal=decal,
                s=grid_s,
                t=grid_t,
                width=w,
                height=h,
                rim=_rims(decal.reshape(len(s), len(t))),
            )
        )
    return _join(parts)


def _rims(decal: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return (S * T, 4) where another decal, or nothing, lies beyond a cell of an S x T grid."""
    rim = np.ones((*decal.shape, 4), dtype=bool)
    rim[1:, :, 0] = rim[:-1, :, 1] = decal[1:] != decal[:-1]
    rim[:, 1:, 2] = rim[:, :-1, 3] = decal[:, 1:] != decal[:, :-1]
    return rim.reshape(-1, 4)


def decal_at(patch: Patch, s: Array, t: Array) -> NDArray[np.int64]:
    """Return the index of the topmost decal at places of a patch, -1 for none."""
    found = np.full(len(s), -1, dtype=np.int64)
    for index, decal in enumerate(patch.decals):
        u0, v0, u1, v1 = decal.rect
        found[(s >= u0) & (s < u1) & (t >= v0) & (t < v1)] = index
    return found


def _edges(marks: Sequence[float], end: float) -> Array:
    inside = sorted(mark for mark in set(marks) if 0.004 < mark < end - 0.004)
    kept = [0.0]
    for mark in inside:
        if mark - kept[-1] > 0.004:
            kept.append(mark)
    return np.array([*kept, end])


def _looks_away(
    cells: Cells, geometry: Frames, middle: Array, eyes: Sequence[Vector]
) -> NDArray[np.bool_]:
    normal = geometry.normal[cells.patch]
    away = np.ones(len(cells), dtype=bool)
    for eye in eyes:
        away &= dot(normal, np.array(eye) - middle) < 0.0
    return away


def _select(cells: Cells, mask: NDArray[np.bool_]) -> Cells:
    return Cells(
        patch=cells.patch[mask],
        decal=cells.decal[mask],
        s=cells.s[mask],
        t=cells.t[mask],
        width=cells.width[mask],
        height=cells.height[mask],
        rim=cells.rim[mask],
    )


def _halves(cells: Cells, split_u: NDArray[np.bool_], split_v: NDArray[np.bool_]) -> Cells:
    parts: list[Cells] = []
    for mask, is_u in ((split_u, True), (split_v & ~split_u, False)):
        chosen = _select(cells, mask)
        for sign in (-0.25, 0.25):
            rim = chosen.rim.copy()
            rim[:, (0 if is_u else 2) + (sign < 0)] = False
            parts.append(
                Cells(
                    patch=chosen.patch,
                    decal=chosen.decal,
                    s=chosen.s + sign * chosen.width * is_u,
                    t=chosen.t + sign * chosen.height * (not is_u),
                    width=chosen.width * (0.5 if is_u else 1.0),
                    height=chosen.height * (1.0 if is_u else 0.5),
                    rim=rim,
                )
            )
    return _join(parts)


def _join(parts: Sequence[Cells]) -> Cells:
    def all_of(name: str) -> NDArray[Any]:
        return np.concatenate([getattr(part, name) for part in parts])

    if not parts:
        empty = np.zeros(0)
        none = np.zeros(0, dtype=np.int64)
        rim = np.zeros((0, 4), dtype=bool)
        return Cells(patch=none, decal=none, s=empty, t=empty, width=empty, height=empty, rim=rim)
    names = ("patch", "decal", "s", "t", "width", "height", "rim")
    return Cells(**{name: all_of(name) for name in names})


def paint(
    patches: Sequence[Patch], geometry: Frames, cells: Cells, light: Light
) -> tuple[Array, Array]:
    """Return albedo and glow of cells, both (N, 3), linear."""
    albedo = np.zeros((len(cells), 3))
    glow = np.zeros((len(cells), 3))
    names: dict[str, int] = {}
    most = max((len(patch.decals) for patch in patches), default=0)
    # For each patch and decal (the last column: none): material, corner, size, texture.
    material = np.zeros((len(patches), most + 1), dtype=np.int64)
    box = np.zeros((len(patches), most + 1, 6))
    for index, patch in enumerate(patches):
        material[index, -1] = names.setdefault(patch.material, len(names))
        box[index, -1] = (
            0.0, 0.0, geometry.width[index], geometry.height[index], *patch.texture
        )  # fmt: skip
        for number, decal in enumerate(patch.decals):
            u0, v0, u1, v1 = decal.rect
            material[index, number] = names.setdefault(decal.material, len(names))
            box[index, number] = (u0, v0, u1 - u0, v1 - v0, 0.0, 0.0)
    points = position(cells, geometry)
    of = material[cells.patch, cells.decal]
    for name, number in names.items():
        mine = np.flatnonzero(of == number)
        if len(mine) == 0:
            continue
        at = cells.patch[mine]
        frame = box[at, cells.decal[mine]]
        s, t = cells.s[mine] - frame[:, 0], cells.t[mine] - frame[:, 1]
        result = coat(
            name,
            Spots(
                p=points[mine],
                n=geometry.normal[at],
                u=s + frame[:, 4],
                v=t + frame[:, 5],
                s=s,
                t=t,
                w=frame[:, 2],
                h=frame[:, 3],
                blur=np.sqrt(cells.width[mine] * cells.height[mine]),
                seed=((at + 1) * 7919 + (cells.decal[mine] + 1) * 104729).astype(np.uint32),
                light=light,
            ),
        )
        albedo[mine] = np.clip(result.albedo, 0.004, 0.92)
        if result.glow is not None:
            glow[mine] = np.maximum(result.glow, 0.0)
    return albedo, glow
