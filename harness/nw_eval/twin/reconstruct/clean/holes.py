"""Where a surface ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nw_eval.twin.reconstruct.clean.parts import parts_of
from nw_eval.twin.reconstruct.mesh_file import ColourMesh


@dataclass(frozen=True, kw_only=True)
class Hole:
    """A closed border of the surface; the longest one is usually its rim.

    Attributes:
        centre: (x, y, z) mean of the border.
        length: of the border.
        across: diagonal of the box about it.
    """

    centre: tuple[float, float, float]
    length: float
    across: float


def holes(mesh: ColourMesh) -> list[Hole]:
    """Return the borders, the longest first: edges of one face. Borders that touch are one."""
    edges = np.concatenate([mesh.faces[:, [k, (k + 1) % 3]] for k in range(3)]).astype(np.int64)
    count = len(mesh.vertices)
    keys = np.sort(edges, axis=1) @ np.array([count, 1])
    _, place, uses = np.unique(keys, return_index=True, return_counts=True)
    border = edges[place[uses == 1]]
    if len(border) == 0:
        return []
    used, local = np.unique(border, return_inverse=True)
    local = local.reshape(-1, 2)
    loops, whose = parts_of(local, len(used))
    ends = mesh.vertices[border]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    own = whose[local[:, 0]]
    order = np.argsort(own, kind="stable")
    found: list[Hole] = []
    for rows in np.split(order, np.searchsorted(own[order], np.arange(1, loops))):
        points = ends[rows].reshape(-1, 3)
        x, y, z = points.mean(axis=0)
        span = points.max(axis=0) - points.min(axis=0)
        found.append(
            Hole(
                centre=(float(x), float(y), float(z)),
                length=float(lengths[rows].sum()),
                across=float(np.linalg.norm(span)),
            )
        )
    return sorted(found, key=lambda hole: (-hole.length, hole.centre))
