"""What a log's scene holds, as triangles: boxes, cylinders, ellipsoids and meshes alike."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.scenes.mesh import rotation_matrix

Colour = tuple[int, int, int]


def triangles_of(entity: Any) -> list[tuple[NDArray[np.float32], NDArray[np.uint32], Colour]]:
    """Return the shapes of a `foxglove.SceneEntity`, in its frame.

    Returns:
        For each: vertices (V, 3) m, faces (F, 3), and its colour.

    Raises:
        ValueError: a mesh has corners that are not there.
    """
    import trimesh

    found: list[tuple[NDArray[np.float32], NDArray[np.uint32], Colour]] = []
    for mesh in entity.triangles:
        points = np.array([(p.x, p.y, p.z) for p in mesh.points], np.float64).reshape(-1, 3)
        faces = np.array(mesh.indices, np.int64)
        if faces.size % 3 or (faces.size and faces.max() >= len(points)):
            raise ValueError("a mesh has corners that are not there")
        if faces.size:
            found.append(_shape(points, faces.reshape(-1, 3), mesh.color))
    solids = (
        (entity.cubes, trimesh.creation.box(extents=(1.0, 1.0, 1.0))),
        (entity.cylinders, trimesh.creation.cylinder(radius=0.5, height=1.0, sections=24)),
        (entity.spheres, trimesh.creation.icosphere(subdivisions=2, radius=0.5)),
    )
    for shapes, solid in solids:
        for each in shapes:
            size = np.array([each.size.x, each.size.y, each.size.z])
            p, q = each.pose.position, each.pose.orientation
            turned = (solid.vertices * size) @ rotation_matrix((q.w, q.x, q.y, q.z)).T
            moved = turned + np.array([p.x, p.y, p.z])
            found.append(_shape(moved, solid.faces, each.color))
    return found


def _shape(
    points: Any, faces: Any, color: Any
) -> tuple[NDArray[np.float32], NDArray[np.uint32], Colour]:
    red, green, blue = (
        min(255, max(0, round(255.0 * channel))) for channel in (color.r, color.g, color.b)
    )
    corners = np.asarray(points, np.float32)
    return corners, np.asarray(faces, np.uint32), (red, green, blue)
