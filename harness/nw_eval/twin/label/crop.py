"""A box of the world, and what a mesh is within it: triangles are cut at its sides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import UsageError
from nw_eval.scenes.mesh import TriangleMesh
from nw_eval.twin.label.placement import Point


@dataclass(frozen=True, kw_only=True)
class CropBox:
    """What is kept of a place: a box with its sides along the world's axes.

    Attributes:
        low: smallest x, y, z; world, m.
        high: largest x, y, z.

    Raises:
        UsageError: nothing lies between `low` and `high`.
    """

    low: Point
    high: Point

    def __post_init__(self) -> None:
        if not all(low < high for low, high in zip(self.low, self.high, strict=True)):
            raise UsageError(
                f"a crop from {list(self.low)} to {list(self.high)} holds nothing",
                fix="give a low corner that is below the high one along x, y and z",
            )


def cropped(mesh: TriangleMesh, box: CropBox) -> TriangleMesh:
    """Return the part of a mesh in a box, without lids where it is cut; kinds stay.

    Vertices that no face needs any more are left out. Nothing may be left: no faces then.
    """
    for axis in range(3):
        mesh = _cut(mesh, mesh.vertices[:, axis] - box.low[axis])
        mesh = _cut(mesh, box.high[axis] - mesh.vertices[:, axis])
    needed, faces = np.unique(mesh.faces, return_inverse=True)
    return TriangleMesh(
        vertices=mesh.vertices[needed],
        faces=faces.reshape(-1, 3).astype(np.int32),
        kinds=mesh.kinds,
    )


def _cut(mesh: TriangleMesh, depth: NDArray[np.float64]) -> TriangleMesh:
    """Return the part of a mesh where `depth` (V,), which is linear in space, is not negative."""
    count = (depth[mesh.faces] >= 0).sum(axis=1)
    one, two = (_turned(mesh, depth, np.flatnonzero(count == n)) for n in (1, 2))
    first = len(mesh.vertices)
    # Of a corner inside, the two edges that leave it; of two, the edges that leave the pair.
    tips = (
        _crossings(mesh, depth, one[:, 0], one[:, 1]),
        _crossings(mesh, depth, one[:, 0], one[:, 2]),
    )
    ends = (
        _crossings(mesh, depth, two[:, 1], two[:, 2]),
        _crossings(mesh, depth, two[:, 0], two[:, 2]),
    )
    a, b = first + np.arange(len(one)), first + len(one) + np.arange(len(one))
    start = first + 2 * len(one)
    c, d = start + np.arange(len(two)), start + len(two) + np.arange(len(two))
    faces = [
        mesh.faces[count == 3],
        np.column_stack([one[:, 0], a, b]),
        np.column_stack([two[:, 0], two[:, 1], c]),
        np.column_stack([two[:, 0], c, d]),
    ]
    kinds = [mesh.kinds[count == n] for n in (3, 1, 2, 2)]
    return TriangleMesh(
        vertices=np.concatenate([mesh.vertices, *tips, *ends]),
        faces=np.concatenate(faces).astype(np.int32),
        kinds=np.concatenate(kinds),
    )


def _turned(
    mesh: TriangleMesh, depth: NDArray[np.float64], rows: NDArray[np.intp]
) -> NDArray[np.int64]:
    """Return faces with their odd corner first (one inside), or last (two inside), same winding."""
    faces = mesh.faces[rows].astype(np.int64)
    inside = depth[faces] >= 0
    alone = inside.sum(axis=1) == 1
    odd = np.where(alone, inside.argmax(axis=1), (~inside).argmax(axis=1))
    begin = np.where(alone, odd, odd + 1)
    return np.take_along_axis(faces, (begin[:, None] + np.arange(3)) % 3, axis=1)


def _crossings(
    mesh: TriangleMesh,
    depth: NDArray[np.float64],
    kept: NDArray[np.int64],
    lost: NDArray[np.int64],
) -> NDArray[np.float64]:
    share = depth[kept] / (depth[kept] - depth[lost])
    return mesh.vertices[kept] + share[:, None] * (mesh.vertices[lost] - mesh.vertices[kept])
