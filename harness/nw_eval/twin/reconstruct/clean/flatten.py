"""Floors and walls that are flat are made flat, where the evidence agrees.

What lies within a voxel of a plane is compared with it patch by patch: noise is mean-free in a
patch, a threshold, a mat or a step is not. Only patches whose mean is as near to the plane as a
single vertex is to its patch are moved.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.twin.reconstruct.mesh_file import ColourMesh
from nw_eval.twin.reconstruct.planes.search import PlaneSearch

F64 = NDArray[np.float64]

_PLANES = 12
_LEAST_AREA = 0.03
"""Of all area, below which a plane is not looked for: what is small may be a rounded corner."""
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
    search = PlaneSearch.of(mesh, voxel)
    area = search.area
    free = area > 0
    vertices, planes = mesh.vertices.copy(), []
    rng = np.random.default_rng(0)
    for _ in range(_PLANES):
        plane = search.best(free, rng)
        if plane is None:
            break
        normal, offset = plane
        near = free & search.near(normal, offset)
        if area[near].sum() < _LEAST_AREA * area.sum():
            break
        shift, flat = flattened(search, near, normal, offset)
        vertices += shift
        free &= ~near
        planes.append(flat)
    planes.sort(key=lambda plane: -plane.area)
    return ColourMesh(vertices=vertices, faces=mesh.faces, colours=mesh.colours), planes


def flattened(
    search: PlaneSearch, near: NDArray[np.bool_], normal: F64, offset: float
) -> tuple[F64, FlatPlane]:
    """Return how vertices (V, 3) move that are made flat, and the plane.

    Args:
        search: the mesh.
        near: (V,) which vertices are of the plane.
        normal: (3,) of it.
        offset: along it.
    """
    off = search.points @ normal - offset
    share, noise = _agreement(search.links, off, near, search.voxel)
    x, y, z = (float(part) for part in normal)
    plane = FlatPlane(
        normal=(x, y, z),
        offset=offset,
        area=float(search.area[near].sum()),
        noise=noise,
        moved=float((share[near] == 1.0).mean()),
    )
    return -(share * off)[:, None] * normal, plane


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
