"""Planes in a mesh: each is grown from a vertex, as RANSAC tries many."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.twin.reconstruct.mesh_file import ColourMesh
from nw_eval.twin.reconstruct.packages import package

F64 = NDArray[np.float64]

BAND = 1.0
"""Voxels from a plane within which a vertex may be of it."""
COSINE = np.cos(np.deg2rad(25.0))
_TRIES = 24
_SAMPLE = 20_000
"""Vertices that a plane is sought among."""
_FIRST = 8.0
"""Voxels about a seed that its first plane is fitted to."""
_LEAST_FIT = 8
"""Vertices that a plane is fitted to."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaneSearch:
    """A mesh as planes are sought in it.

    Attributes:
        points: (V, 3).
        normals: (V, 3) of unit length, smoothed over neighbours.
        area: (V,) a third of that of its faces.
        links: sparse (V, V) of 0 and 1: which vertices share an edge.
        voxel: edge of a voxel.
    """

    points: F64
    normals: F64
    area: F64
    links: Any
    voxel: float

    @classmethod
    def of(cls, mesh: ColourMesh, voxel: float) -> PlaneSearch:
        """Return the search in a mesh of about one vertex to a voxel's face, not simplified."""
        normals, area = _of_vertices(mesh)
        links = _links(mesh)
        for _ in range(3):
            normals = links @ normals + normals
        unit = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        return cls(points=mesh.vertices, normals=unit, area=area, links=links, voxel=voxel)

    def near(self, normal: F64, offset: float, band: float = BAND) -> NDArray[np.bool_]:
        """Return which vertices (V,) lie within so many voxels of a plane, and face as it does."""
        off = np.abs(self.points @ normal - offset)
        return (off < band * self.voxel) & (self.normals @ normal > COSINE)

    def best(self, free: NDArray[np.bool_], rng: np.random.Generator) -> tuple[F64, float] | None:
        """Return the plane with the most free area near it of some tries; None without any.

        Args:
            free: (V,) which vertices are of no plane yet.
            rng: of the tries.
        """
        area = np.where(free, self.area, 0.0)
        if not area.any():
            return None
        rows = np.flatnonzero(area)
        weight = area[rows] / area[rows].sum()
        if len(rows) > _SAMPLE:
            rows = rng.choice(rows, _SAMPLE, p=weight)
            weight = np.full(_SAMPLE, 1.0 / _SAMPLE)
        points, normals = self.points[rows], self.normals[rows]
        best, most = None, 0.0
        for seed in rng.choice(len(points), _TRIES, p=weight):
            normal, offset = _grown(points, normals, weight, int(seed), self.voxel)
            near = np.abs(points @ normal - offset) < BAND * self.voxel
            found = float(weight[near & (normals @ normal > COSINE)].sum())
            if found > most:
                best, most = (normal, offset), found
        return best


def _grown(points: F64, normals: F64, weight: F64, seed: int, voxel: float) -> tuple[F64, float]:
    """Return a plane through a seed, fitted to ever more of what lies near it."""
    centre, normal = points[seed], normals[seed]
    offset = float(centre @ normal)
    reach = np.linalg.norm(points - centre, axis=1)
    radius, band = _FIRST * voxel, BAND * voxel
    while True:
        off = points @ normal - offset
        near = (reach < radius) & (np.abs(off) < band) & (normals @ normal > COSINE)
        if near.sum() < _LEAST_FIT:
            return normal, offset
        normal, offset = _fitted(points[near], weight[near], normal)
        if radius > reach.max():
            break
        radius *= 2.0
    for _ in range(3):  # What belongs to a step or a mat is to have no say.
        off = points @ normal - offset
        near = (np.abs(off) < band) & (normals @ normal > COSINE)
        if near.sum() < _LEAST_FIT:
            break
        middle = float(np.median(off[near]))
        spread = 1.4826 * float(np.median(np.abs(off[near] - middle)))
        near &= np.abs(off - middle) <= max(2.0 * spread, 0.1 * voxel)
        normal, offset = _fitted(points[near], weight[near], normal)
    return normal, offset


def _fitted(points: F64, weight: F64, like: F64) -> tuple[F64, float]:
    """Return the plane of least squares, its normal on the same side as `like`."""
    share = (weight / weight.sum())[:, None]
    centre = (points * share).sum(axis=0)
    rest = points - centre
    _, axes = np.linalg.eigh((rest[:, :, None] * rest[:, None, :] * share[:, :, None]).sum(axis=0))
    normal = axes[:, 0] * (1.0 if axes[:, 0] @ like >= 0.0 else -1.0)
    return normal, float(centre @ normal)


def _of_vertices(mesh: ColourMesh) -> tuple[F64, F64]:
    """Return each vertex's normal (V, 3), weighted by area, and a third of its faces' area."""
    normals, areas = np.zeros_like(mesh.vertices), np.zeros(len(mesh.vertices))
    faces = mesh.normals
    size = np.linalg.norm(faces, axis=1) / 6.0
    for k in range(3):
        corner = mesh.faces[:, k]
        areas += np.bincount(corner, size, minlength=len(areas))
        for axis in range(3):
            normals[:, axis] += np.bincount(corner, faces[:, axis], minlength=len(areas))
    return normals, areas


def _links(mesh: ColourMesh) -> Any:
    sparse = package("scipy.sparse")
    one, other = mesh.faces.ravel(), np.roll(mesh.faces, -1, axis=1).ravel()
    count = len(mesh.vertices)
    both = (np.concatenate([one, other]), np.concatenate([other, one]))
    matrix = sparse.coo_array((np.ones(len(both[0])), both), shape=(count, count)).tocsr()
    matrix.data[:] = 1.0
    return matrix
