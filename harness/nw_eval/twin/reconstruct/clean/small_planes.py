"""Small planes are made flat too, where photographs or edges speak for them.

A slope, a tread or the top of a box is a hundredth of all that photographs show: too little to be
told from a rounded corner by its area alone. But pixels were given planes that views agree on; what
lies on one of those is flat.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nw_eval.twin.reconstruct.clean.flatten import FlatPlane, flattened
from nw_eval.twin.reconstruct.mesh_file import ColourMesh
from nw_eval.twin.reconstruct.planes.hypotheses import SupposedPlane
from nw_eval.twin.reconstruct.planes.search import PlaneSearch

ROOM = 480.0
"""Area of a small plane, in squares of a voxel's edge: about a step that a foot has room on."""


def flatten_small(
    mesh: ColourMesh,
    planes: Sequence[FlatPlane],
    supposed: Sequence[SupposedPlane],
    voxel: float,
) -> tuple[ColourMesh, list[FlatPlane]]:
    """Return the mesh with supposed planes flat that it shows, and those, the largest first.

    No vertex moves by more than a voxel. The same mesh gives the same bits.

    Args:
        mesh: of `flatten`.
        planes: that it is flat on already.
        supposed: planes that pixels may have been given.
        voxel: edge of a voxel.
    """
    search = PlaneSearch.of(mesh, voxel)
    free = search.area > 0
    for plane in planes:
        free &= ~search.near(np.array(plane.normal), plane.offset)
    sides = [
        side
        for plane in supposed
        for side in ((plane,) if plane.one_sided else (plane, plane.turned()))
    ]
    areas = [float(search.area[free & search.near(s.normal, s.offset)].sum()) for s in sides]
    vertices, small = mesh.vertices.copy(), list[FlatPlane]()
    for number in np.argsort(-np.array(areas), kind="stable"):
        side = sides[number]
        near = free & search.near(side.normal, side.offset)
        if search.area[near].sum() < ROOM * voxel**2:
            continue
        shift, flat = flattened(search, near, side.normal, side.offset)
        vertices += shift
        free &= ~near
        small.append(flat)
    small.sort(key=lambda plane: -plane.area)
    return ColourMesh(vertices=vertices, faces=mesh.faces, colours=mesh.colours), small
