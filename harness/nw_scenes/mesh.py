"""Triangle meshes: what rays against static geometry meet.

Also here: the traffic cone that marks a waypoint. It moves, so it is never part of a splat.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from nw_base import same_bits

FaceKind = Literal["ground", "obstacle", "structure", "clutter", "overhead", "beside"]
FACE_KINDS: tuple[FaceKind, ...] = get_args(FaceKind)

# Corners of the unit cube, and two triangles for each of its faces, counter-clockwise from outside.
_CUBE = np.array(
    [[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)], dtype=np.float64
)
_CUBE_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2],  # -x
        [4, 6, 7], [4, 7, 5],  # +x
        [0, 4, 5], [0, 5, 1],  # -y
        [2, 3, 7], [2, 7, 6],  # +y
        [0, 2, 6], [0, 6, 4],  # -z
        [1, 5, 7], [1, 7, 3],  # +z
    ],
    dtype=np.int32,
)  # fmt: skip

CONE_BASE = 0.18
"""Width and depth of its foot, metres."""

CONE_HEIGHT = 0.20
"""Metres."""

_SIDES = 16
_FOOT = 0.014
_ORANGE = (0.95, 0.33, 0.07)
_WHITE = (0.93, 0.93, 0.91)
_DARK = (0.80, 0.25, 0.05)
# Height as a share of the cone, radius in metres, and the colour of the ring that ends there.
_RINGS = (
    (_FOOT / CONE_HEIGHT, 0.065, _DARK),
    (0.42, 0.045, _ORANGE),
    (0.68, 0.0295, _WHITE),
    (0.985, 0.0125, _ORANGE),
    (1.0, 0.0, _ORANGE),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class TriangleMesh:
    """Triangles in world metres; a face is counter-clockwise seen from its outside.

    Attributes:
        vertices: (V, 3) float64, metres.
        faces: (F, 3) int32 indices into `vertices`.
        kinds: (F,) uint8, what each face belongs to: an index into `FACE_KINDS`. Height queries
            look through what hangs `overhead`, and through what stands `beside` a published
            course: its walls, which its scandots leave out.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    kinds: NDArray[np.uint8]

    @property
    def triangles(self) -> NDArray[np.float64]:
        """Corner points, (F, 3, 3)."""
        return self.vertices[self.faces]


def rotation_matrix(quat: Sequence[float]) -> NDArray[np.float64]:
    """Return the (3, 3) rotation of a w x y z quaternion; it need not be of unit length."""
    w, x, y, z = np.asarray(quat, dtype=np.float64) / same_bits.length(quat)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def box_mesh(
    center: Sequence[float], half_size: Sequence[float], quat: Sequence[float], kind: FaceKind
) -> TriangleMesh:
    """Return the closed 12-triangle mesh of a box: centre and half sizes in metres, quat wxyz."""
    local = _CUBE * np.asarray(half_size, dtype=np.float64)
    rotation = rotation_matrix(quat)
    # Products written out: a BLAS call may round differently from one CPU to the next.
    turned = (
        local[:, :1] * rotation[:, 0]
        + local[:, 1:2] * rotation[:, 1]
        + local[:, 2:] * rotation[:, 2]
    )
    return TriangleMesh(
        vertices=turned + np.asarray(center, dtype=np.float64),
        faces=_CUBE_FACES.copy(),
        kinds=np.full(len(_CUBE_FACES), FACE_KINDS.index(kind), dtype=np.uint8),
    )


def quad_mesh(
    origin: Sequence[float], u: Sequence[float], v: Sequence[float], kind: FaceKind
) -> TriangleMesh:
    """Return the two triangles of a parallelogram at `origin` with edges `u` and `v`, metres."""
    corner, along, across = (np.asarray(part, dtype=np.float64) for part in (origin, u, v))
    return TriangleMesh(
        vertices=np.stack([corner, corner + along, corner + along + across, corner + across]),
        faces=np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32),
        kinds=np.full(2, FACE_KINDS.index(kind), dtype=np.uint8),
    )


def merge(meshes: Sequence[TriangleMesh]) -> TriangleMesh:
    """Return one mesh of all faces, in order; vertices are not welded."""
    if not meshes:
        return TriangleMesh(
            vertices=np.zeros((0, 3)),
            faces=np.zeros((0, 3), dtype=np.int32),
            kinds=np.zeros(0, dtype=np.uint8),
        )
    starts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    return TriangleMesh(
        vertices=np.concatenate([mesh.vertices for mesh in meshes]),
        faces=np.concatenate(
            [mesh.faces + np.int32(start) for mesh, start in zip(meshes, starts, strict=True)]
        ),
        kinds=np.concatenate([mesh.kinds for mesh in meshes]),
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
    foot = box_mesh(
        (0, 0, _FOOT / 2), (CONE_BASE / 2, CONE_BASE / 2, _FOOT / 2), (1, 0, 0, 0), "clutter"
    )
    colors = [_DARK] * len(foot.faces)
    points: list[tuple[float, float, float]] = []
    for share, radius, _ in _RINGS:
        points += [
            (
                radius * math.cos(2 * math.pi * side / _SIDES),
                radius * math.sin(2 * math.pi * side / _SIDES),
                share * CONE_HEIGHT,
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
