"""The traffic cone that marks a waypoint: a moving object, so never part of a splat."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_eval.scenes.mesh import FACE_KINDS, TriangleMesh, box_mesh, merge

BASE = 0.18
"""Width and depth of its foot, metres."""

HEIGHT = 0.20
"""Metres."""

_SIDES = 16
_FOOT = 0.014
_ORANGE = (0.95, 0.33, 0.07)
_WHITE = (0.93, 0.93, 0.91)
_DARK = (0.80, 0.25, 0.05)
# Height as a share of the cone, radius in metres, and the colour of the ring that ends there.
_RINGS = (
    (_FOOT / HEIGHT, 0.065, _DARK),
    (0.42, 0.045, _ORANGE),
    (0.68, 0.0295, _WHITE),
    (0.985, 0.0125, _ORANGE),
    (1.0, 0.0, _ORANGE),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Cone:
    """A mesh with a colour for each face.

    Attributes:
        mesh: stands on z = 0 with its axis at x = y = 0, metres.
        colors: (F, 3) float32, 0 to 1, as displayed (sRGB).
    """

    mesh: TriangleMesh
    colors: NDArray[np.float32]


def cone_mesh() -> Cone:
    """Return the 0.18 x 0.18 x 0.20 m cone: orange, with a white band, on a square foot."""
    foot = box_mesh((0, 0, _FOOT / 2), (BASE / 2, BASE / 2, _FOOT / 2), (1, 0, 0, 0), "clutter")
    colors = [_DARK] * len(foot.faces)
    points: list[tuple[float, float, float]] = []
    for share, radius, _ in _RINGS:
        points += [
            (
                radius * math.cos(2 * math.pi * side / _SIDES),
                radius * math.sin(2 * math.pi * side / _SIDES),
                share * HEIGHT,
            )
            for side in range(_SIDES)
        ]
    faces: list[tuple[int, int, int]] = []
    for ring, (_, _, color) in enumerate(_RINGS[1:]):
        for side in range(_SIDES):
            after = (side + 1) % _SIDES
            low, high = ring * _SIDES, (ring + 1) * _SIDES
            faces.append((low + side, low + after, high + after))
            faces.append((low + side, high + after, high + side))
            colors += [color, color]
    mantle = TriangleMesh(
        vertices=np.array(points),
        faces=np.array(faces, dtype=np.int32),
        kinds=np.full(len(faces), FACE_KINDS.index("clutter"), dtype=np.uint8),
    )
    return Cone(mesh=merge([foot, mantle]), colors=np.array(colors, dtype=np.float32))
