"""The parts of a mesh that hang together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_eval.twin.reconstruct.mesh_file import ColourMesh
from nw_eval.twin.reconstruct.packages import package

_CRUMB, _ISLAND = 0.8, 0.5
"""Share of a part's vertices that lie on a plane, if it is an island of it: chance puts most of a
crumb near one of a place's many planes, and seldom half of what a foot has room on."""


@dataclass(frozen=True, kw_only=True)
class PartsKept:
    """What became of a mesh's parts.

    Attributes:
        kept: how many.
        dropped: how many.
        dropped_area: of those, a share of all area.
    """

    kept: int
    dropped: int
    dropped_area: float


def large_parts(
    mesh: ColourMesh, least: float, flat: NDArray[np.bool_] | None = None, room: float = np.inf
) -> tuple[ColourMesh, PartsKept]:
    """Return a mesh of the largest part, of those with at least a share of its area, and flat ones.

    Args:
        mesh: to choose from.
        least: share.
        flat: (V,) whether a vertex lies on a plane of the place; parts that do for the most are
            islands of a floor or a wall that is plain between them. None = nobody knows.
        room: area from which on a part is no crumb: nobody photographs the sides of a platform
            that stands in a pit, so that its top hangs together with nothing.
    """
    count, part = parts_of(mesh.faces, len(mesh.vertices))
    own = part[mesh.faces[:, 0]]
    area = np.bincount(own, 0.5 * np.linalg.norm(mesh.normals, axis=1), minlength=count)
    large = area >= max(least * area.max(), 1e-300)
    if flat is not None:
        vertices = np.bincount(part, minlength=count)
        share = np.where(area < room, _CRUMB, _ISLAND)
        large |= np.bincount(part, flat, minlength=count) > share * vertices
    facts = PartsKept(
        kept=int(large.sum()),
        dropped=int(count - large.sum()),
        dropped_area=float(area[~large].sum() / max(area.sum(), 1e-300)),
    )
    return mesh.keep(large[own]), facts


def parts_of(links: NDArray[np.integer], count: int) -> tuple[int, NDArray[np.int32]]:
    """Return how many parts `count` vertices are in, and the part of each.

    Args:
        links: (N, K), K >= 2: vertices in a row belong together.
        count: of vertices.
    """
    sparse, graph = package("scipy.sparse"), package("scipy.sparse.csgraph")
    one = np.repeat(links[:, 0], links.shape[1] - 1)
    other = links[:, 1:].ravel()
    ones = np.ones(len(one), np.int8)
    matrix = sparse.coo_array((ones, (one, other)), shape=(count, count))
    return graph.connected_components(matrix, directed=False)
