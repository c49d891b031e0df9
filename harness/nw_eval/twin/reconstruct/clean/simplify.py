"""Fewer faces: flat parts become coarse, edges stay fine (Garland and Heckbert 1997)."""

from __future__ import annotations

import numpy as np

from nw_eval.twin.reconstruct.mesh_file import ColourMesh
from nw_eval.twin.reconstruct.packages import package


def simplify(mesh: ColourMesh, most: int) -> ColourMesh:
    """Return the mesh with about `most` faces at most, coloured by the nearest of its vertices.

    Raises:
        PrerequisiteError: fast-simplification or SciPy is not installed.
    """
    if len(mesh.faces) <= most:
        return mesh
    # About its middle, for it works in single precision.
    middle = mesh.vertices.mean(axis=0)
    points, faces = package("fast_simplification").simplify(
        mesh.vertices - middle, mesh.faces, target_count=most, agg=5
    )
    vertices = np.asarray(points, np.float64) + middle
    _, nearest = package("scipy.spatial").cKDTree(mesh.vertices).query(vertices)
    simple = ColourMesh(
        vertices=vertices, faces=np.asarray(faces, np.int32), colours=mesh.colours[nearest]
    )
    return simple.keep((simple.normals != 0.0).any(axis=1))
