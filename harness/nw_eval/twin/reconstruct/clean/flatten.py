"""Floors and walls that are flat are made flat, where the evidence agrees.

A plane is found by growing from a vertex, as RANSAC tries many. What lies within a voxel of it is
compared with it patch by patch: noise is mean-free in a patch, a threshold, a mat or a step is not.
Only patches whose mean is as near to the plane as a single vertex is to its patch are moved.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.twin.reconstruct.mesh_file import ColourMesh
from nw_eval.twin.reconstruct.packages import package

F64 = NDArray[np.float64]

_PLANES, _TRIES = 12, 24
_LEAST_AREA = 0.03
"""Of all area, below which a plane is not looked for: what is small may be a rounded corner."""
_SAMPLE = 20_000
"""Vertices that a plane is sought among."""
_FIRST = 8.0
"""Voxels about a seed that its first plane is fitted to."""
_LEAST_FIT = 8
"""Vertices that a plane is fitted to."""
_BAND = 1.0
"""Voxels from a plane within which a vertex may be of it."""
_COSINE = np.cos(np.deg2rad(25.0))
_RINGS = 16
"""Steps of averaging with neighbours: a patch is about four edges in radius."""
_LEAST_NOISE = 0.15
"""Voxels: agreement is not asked to be better than a voxel can show."""


@dataclass(frozen=True, kw_only=True)
class FlatPlane:
    """A plane n . x = offset that vertices were moved to.

    Attributes:
        normal: unit vector, out of the surface.
        offset: along it.
        area: of the vertices within a voxel of it.
        noise: standard deviation of a vertex from its patch, before.
        moved: share of those vertices that were moved all the way.
    """

    normal: tuple[float, float, float]
    offset: float
    area: float
    noise: float
    moved: float


def flatten(mesh: ColourMesh, voxel: float) -> tuple[ColourMesh, list[FlatPlane]]:
    """Return the mesh with flat planes flat, and the planes, the largest first.

    No vertex moves by more than a voxel. The same mesh gives the same bits.

    Args:
        mesh: of about one vertex to a voxel's face, not simplified.
        voxel: edge of a voxel.
    """
    normals, area = _of_vertices(mesh)
    links = _links(mesh)
    smoothed = _unit(_averaged(links, normals, 3))
    free = area > 0
    vertices, planes = mesh.vertices.copy(), []
    rng = np.random.default_rng(0)
    for _ in range(_PLANES):
        plane = _best_plane(mesh.vertices, smoothed, np.where(free, area, 0.0), voxel, rng)
        if plane is None:
            break
        normal, offset = plane
        off = mesh.vertices @ normal - offset
        near = free & (np.abs(off) < _BAND * voxel) & (smoothed @ normal > _COSINE)
        if area[near].sum() < _LEAST_AREA * area.sum():
            break
        share, noise = _agreement(links, off, near, voxel)
        vertices -= (share * off)[:, None] * normal
        free &= ~near
        x, y, z = (float(part) for part in normal)
        planes.append(
            FlatPlane(
                normal=(x, y, z),
                offset=offset,
                area=float(area[near].sum()),
                noise=noise,
                moved=float((share[near] == 1.0).mean()),
            )
        )
    planes.sort(key=lambda plane: -plane.area)
    return ColourMesh(vertices=vertices, faces=mesh.faces, colours=mesh.colours), planes


def _agreement(links: Any, off: F64, near: NDArray[np.bool_], voxel: float) -> tuple[F64, float]:
    """Return which share of its distance each vertex is to be moved, and the noise of one."""
    inner = near.astype(np.float64)
    patch = off * inner
    for _ in range(_RINGS):
        total = links @ inner + inner
        patch = np.where(near, (links @ patch + patch) / np.maximum(total, 1.0), 0.0)
    noise = 1.4826 * float(np.median(np.abs(off - patch)[near]))
    bound = max(noise, _LEAST_NOISE * voxel)
    beyond = np.clip(np.abs(patch) / bound - 1.0, 0.0, 1.0)
    return np.where(near, 1.0 - beyond * beyond * (3.0 - 2.0 * beyond), 0.0), noise


def _best_plane(
    points: F64, normals: F64, area: F64, voxel: float, rng: np.random.Generator
) -> tuple[F64, float] | None:
    """Return the plane with the most area near it of some tries; None without any area."""
    if not area.any():
        return None
    rows = np.flatnonzero(area)
    weight = area[rows] / area[rows].sum()
    if len(rows) > _SAMPLE:
        rows = rng.choice(rows, _SAMPLE, p=weight)
        weight = np.full(_SAMPLE, 1.0 / _SAMPLE)
    points, normals = points[rows], normals[rows]
    best, most = None, 0.0
    for seed in rng.choice(len(points), _TRIES, p=weight):
        normal, offset = _grown(points, normals, weight, int(seed), voxel)
        near = np.abs(points @ normal - offset) < _BAND * voxel
        found = float(weight[near & (normals @ normal > _COSINE)].sum())
        if found > most:
            best, most = (normal, offset), found
    return best


def _grown(points: F64, normals: F64, weight: F64, seed: int, voxel: float) -> tuple[F64, float]:
    """Return a plane through a seed, fitted to ever more of what lies near it."""
    centre, normal = points[seed], normals[seed]
    offset = float(centre @ normal)
    reach = np.linalg.norm(points - centre, axis=1)
    radius, band = _FIRST * voxel, _BAND * voxel
    while True:
        off = points @ normal - offset
        near = (reach < radius) & (np.abs(off) < band) & (normals @ normal > _COSINE)
        if near.sum() < _LEAST_FIT:
            return normal, offset
        normal, offset = _fitted(points[near], weight[near], normal)
        if radius > reach.max():
            break
        radius *= 2.0
    for _ in range(3):  # What belongs to a step or a mat is to have no say.
        off = points @ normal - offset
        near = (np.abs(off) < band) & (normals @ normal > _COSINE)
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
    """Return which vertices share an edge, as a sparse matrix (V, V) of 0 and 1."""
    sparse = package("scipy.sparse")
    one, other = mesh.faces.ravel(), np.roll(mesh.faces, -1, axis=1).ravel()
    count = len(mesh.vertices)
    both = (np.concatenate([one, other]), np.concatenate([other, one]))
    matrix = sparse.coo_array((np.ones(len(both[0])), both), shape=(count, count)).tocsr()
    matrix.data[:] = 1.0
    return matrix


def _averaged(links: Any, values: F64, rings: int) -> F64:
    for _ in range(rings):
        values = links @ values + values
    return values


def _unit(vectors: F64) -> F64:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300)
