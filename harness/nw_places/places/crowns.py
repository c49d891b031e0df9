"""The closed mesh that stands for a crown of leaves wherever rays are cast."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from nw_places.places.parts import Crown
from nw_scenes.mesh import FACE_KINDS, TriangleMesh

_RINGS = 5
_SIDES = 8


def crown_mesh(crown: Crown) -> TriangleMesh:
    """Return an ellipsoid of 64 faces inscribed in the crown's radii."""
    points = [(0.0, 0.0, -1.0)]
    for ring in range(1, _RINGS):
        polar = math.pi * ring / _RINGS
        points += [
            (
                math.sin(polar) * math.cos(2 * math.pi * side / _SIDES),
                math.sin(polar) * math.sin(2 * math.pi * side / _SIDES),
                -math.cos(polar),
            )
            for side in range(_SIDES)
        ]
    points.append((0.0, 0.0, 1.0))
    last = len(points) - 1
    faces: list[tuple[int, int, int]] = []
    for side in range(_SIDES):
        after = (side + 1) % _SIDES
        faces.append((0, 1 + after, 1 + side))
        for ring in range(_RINGS - 2):
            low = 1 + ring * _SIDES
            high = low + _SIDES
            faces.append((low + side, low + after, high + after))
            faces.append((low + side, high + after, high + side))
        top = 1 + (_RINGS - 2) * _SIDES
        faces.append((top + side, top + after, last))
    exact: NDArray[np.float64] = np.array(points) * np.array(crown.radii) + np.array(crown.center)
    # To a nanometre: sines end differently from one C library to the next.
    vertices = np.round(exact, 9)
    return TriangleMesh(
        vertices=vertices,
        faces=np.array(faces, dtype=np.int32),
        kinds=np.full(len(faces), FACE_KINDS.index(crown.kind), dtype=np.uint8),
    )
