"""Up of a mesh whose cameras are not known: by its file format, its planes, and how it lies.

The posterior is that of `up.py`. Instead of a horizon it has what a format says of its axes, which
many files break, and three broad cues: more of a scene faces up than another way, a scene is wider
than high, and what is in a room stands on its floor.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_scenes.check import room_of
from nw_twin.align.gravity import doubt, sample_mesh
from nw_twin.align.planes import LEVEL, FittedPlane, find_planes, gram, upwards
from nw_twin.align.up import KnownUp, solve_up

Values = NDArray[np.float64]

AXES: Mapping[str, Values] = {
    sign + "xyz"[axis]: (1.0 if sign == "+" else -1.0) * np.eye(3)[axis]
    for axis in range(3)
    for sign in "+-"
}
_Z_UP = {"+z": 0.53, "+y": 0.2, "-y": 0.08, "-z": 0.03, "+x": 0.01, "-x": 0.01}
_FORMATS: Mapping[str, tuple[Mapping[str, float], float]] = {
    # glTF 2.0, "Coordinate System and Units": +Y is up. Exporters that forget to turn leave +z.
    ".glb": (
        {"+y": 0.93, "+z": 0.035, "-y": 0.005, "-z": 0.0015, "+x": 0.002, "-x": 0.002},
        0.05,
    ),
    # OBJ names no axis: of phones and games it is +y, of surveyors +z.
    ".obj": ({"+y": 0.5, "+z": 0.35, "-y": 0.015, "-z": 0.01, "+x": 0.01, "-x": 0.01}, 0.2),
    # Of a splat, that of the first camera or of COLMAP, whose y points down, or an app's.
    ".splat": ({"-y": 0.3, "+y": 0.25, "+z": 0.25, "-z": 0.03, "+x": 0.01, "-x": 0.01}, 0.2),
    ".las": ({"+z": 0.97, "+y": 0.005, "-z": 0.005}, 0.02),  # Map coordinates and a height.
    ".e57": ({"+z": 0.97, "+y": 0.005, "-z": 0.005}, 0.02),  # Scanners are level.
    ".laz": ({"+z": 0.97, "+y": 0.005, "-z": 0.005}, 0.02),
}
"""How probable it is that each axis is up, the rest being the frame of a camera, or of nothing; and
the share of files that were turned upright by eye."""
_TURNED, _BY_EYE = math.radians(0.3), math.radians(4.0)
"""By which the axis of an app is off: a phone's gravity; and that of a frame turned by eye."""
_SHARPNESS, _BINS, _FACING, _LEAST = 8, 400, 5.0, 0.03
"""Exponent of the cosine with which faces count, bins of their normals, weight of the log of the
share that faces along, and a share that chance makes."""
_FLATNESS, _THIN = 2.5, 0.02
"""Weight of the log of the variance of heights, and what is added to it, of all variance."""
_STANDING, _CLEAREST, _LIKE = 15.0, 5.0, math.cos(math.radians(25.0))
"""Log of the odds by how low the contents of a room are, at most, and directions that are alike."""
_TOLERANCE = 0.012
"""How far off a plane a point may be, of the mesh's extent: the root of its variance."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MeshUp:
    """Up of a mesh.

    Attributes:
        up: (3,) unit vector in the file's frame, exactly an axis where it lies within 0.25 degrees.
        uncertain: angle within which up lies with 95 %, degrees.
        axes: probability of each axis, to within 20 degrees, as `+y`; the most probable one first.
    """

    up: Values
    uncertain: float
    axes: Mapping[str, float]


def up_of_mesh(vertices: Values, faces: NDArray[np.integer], suffix: str) -> MeshUp:
    """Return up of a mesh by all cues together.

    Args:
        vertices: (V, 3) in the file's frame and unit.
        faces: (F, 3), counter-clockwise from outside.
        suffix: of the file, e.g. `.glb`.
    """
    rng = np.random.default_rng(0)
    points, normals = sample_mesh(vertices, faces, rng)
    if not len(points):
        return MeshUp(up=AXES["+z"], uncertain=180.0, axes={"+z": 0.0})
    middle = points.mean(axis=0)
    spread = gram(points - middle, np.full(len(points), 1.0 / len(points)))
    tolerance = _TOLERANCE * math.sqrt(max(float(np.trace(spread)), 1e-300))
    planes = find_planes(points, tolerance, rng)
    doubts = [_hidden(plane, points, 3.0 * tolerance) for plane in planes]
    axes, by_eye = _FORMATS.get(suffix, (_Z_UP, 0.2))
    ways = [
        (AXES[name], part * share, sigma)
        for name, share in axes.items()
        for part, sigma in ((1.0 - by_eye, _TURNED), (by_eye, _BY_EYE))
    ]
    first, right, sigma = ways[0]
    known = KnownUp(
        name="format",
        up=first,
        sigma=sigma,
        right=right,
        others=tuple(ways[1:]),
        exact=True,
        reason=f"the axes of {suffix}",
    )
    corners = vertices[faces]
    bins, shares = _binned(normals)
    ends = _ends(planes, [AXES[name] for name in ("+x", "+y", "+z")])
    sides = [(end, _stands(corners, end)) for end in ends]

    def others(ups: Values) -> Values:
        facing = np.einsum("nb,b->n", np.clip(ups @ bins.T, 0.0, None) ** _SHARPNESS, shares)
        variance = np.einsum("ni,ij,nj->n", ups, spread, ups) / np.trace(spread)
        log = _FACING * np.log(facing + _LEAST) - _FLATNESS * np.log(variance + _THIN)
        for end, odds in sides:
            cosine = ups @ end
            # Only which end is up: furniture along a wall is as low from that wall.
            which = math.log(2.0) - np.logaddexp(0.0, -odds * np.sign(cosine))
            log += np.where(np.abs(cosine) > _LIKE, which, 0.0)
        return log

    up = solve_up(None, planes, doubts, [known], others)
    level = [upwards(plane, up.up) for plane in planes]
    level = [one for one in level if one.normal @ up.up > math.cos(math.radians(2.0))]
    if level:
        up = up.by_floor(max(level, key=lambda one: one.share).normal)
    best = up.up
    axis = max(AXES, key=lambda name: float(AXES[name] @ best))
    if AXES[axis] @ best > math.cos(LEVEL):
        best = AXES[axis]
    held = {name: up.probability(way, math.radians(20.0)) for name, way in AXES.items()}
    ordered = dict(sorted(held.items(), key=lambda one: -one[1]))
    return MeshUp(up=best, uncertain=up.around(best), axes=ordered)


def _hidden(plane: FittedPlane, points: Values, far: float) -> float:
    """Return the doubt about a plane as the floor or the ceiling, whichever it may be."""
    senses = (plane.normal, -plane.normal)
    return min(doubt(plane, points, np.zeros((0, 3)), up, far) for up in senses)


def _binned(normals: Values) -> tuple[Values, Values]:
    """Return mean normals (B, 3) of bins, and the share of the normals (N, 3) in each, (B,)."""
    place = np.arange(_BINS) + 0.5
    z, turn = 1.0 - 2.0 * place / _BINS, math.pi * (1.0 + math.sqrt(5.0)) * place
    flat = np.sqrt(1.0 - z * z)
    bins = np.column_stack([flat * np.cos(turn), flat * np.sin(turn), z])
    nearest = np.argmax(normals @ bins.T, axis=1)
    sums = np.column_stack([np.bincount(nearest, axis, _BINS) for axis in normals.T])
    shares = np.bincount(nearest, minlength=_BINS) / len(normals)
    length = np.linalg.norm(sums, axis=1)
    used = length > 0.0
    return sums[used] / length[used, None], shares[used]


def _ends(planes: list[FittedPlane], axes: list[Values]) -> list[Values]:
    """Return directions that may be up or down, none like another."""
    ends: list[Values] = []
    for way in [*axes, *(plane.normal for plane in planes)]:
        if all(abs(float(way @ end)) < _LIKE for end in ends):
            ends.append(way)
    return ends


def _stands(corners: Values, end: Values) -> float:
    """Return the log of the odds that a direction is up, against down, by a room's contents."""
    rooms = (room_of(corners, end), room_of(corners, -end))
    heights = [
        0.5 if room is None else float(np.nan_to_num(room.contents, nan=0.5)) for room in rooms
    ]
    return float(np.clip(0.5 * _STANDING * (heights[1] - heights[0]), -_CLEAREST, _CLEAREST))
