"""What stands in a place, as Rerun's own: meshes, boxes, cylinders, ellipsoids and lines.

It comes from the scene messages of a log, so that it is what Foxglove shows.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.viewing.recording.sdk import rerun_sdk

_LINE = 0.01  # m, radius


def archetypes(entity: Any) -> dict[str, Any]:
    """Return what a `foxglove.SceneEntity` of ours holds, by a name for each kind.

    Raises:
        ValueError: its triangles have corners that are not there.
    """
    rr = rerun_sdk()
    found: dict[str, Any] = {}
    for number, triangles in enumerate(entity.triangles):
        found[f"mesh{number or ''}"] = _mesh(triangles)
    for number, line in enumerate(entity.lines):
        points = [(p.x, p.y, p.z) for p in line.points]
        found[f"line{number or ''}"] = rr.LineStrips3D(
            [points], colors=[_colour(line.color)], radii=_LINE
        )
    if entity.cubes:
        halves = [(0.5 * s.size.x, 0.5 * s.size.y, 0.5 * s.size.z) for s in entity.cubes]
        found["boxes"] = rr.Boxes3D(half_sizes=halves, **_placed(entity.cubes))
    if entity.cylinders:
        found["cylinders"] = cylinders(entity.cylinders)
    if entity.spheres:
        halves = [(0.5 * s.size.x, 0.5 * s.size.y, 0.5 * s.size.z) for s in entity.spheres]
        found["ellipsoids"] = rr.Ellipsoids3D(half_sizes=halves, **_placed(entity.spheres))
    return found


def cylinders(shapes: Any, labels: list[str] | None = None) -> Any:
    """Return `foxglove.CylinderPrimitive`s, which stand along z."""
    named = {} if labels is None else {"labels": labels}
    return rerun_sdk().Cylinders3D(
        lengths=[shape.size.z for shape in shapes],
        radii=[0.5 * shape.size.x for shape in shapes],
        **_placed(shapes),
        **named,
    )


def _placed(shapes: Any) -> dict[str, Any]:
    """Return where shapes stand, and their colours."""
    quats = [shape.pose.orientation for shape in shapes]
    return {
        "centers": [(p.x, p.y, p.z) for p in (shape.pose.position for shape in shapes)],
        "quaternions": [(q.x, q.y, q.z, q.w) for q in quats],
        "colors": [_colour(shape.color) for shape in shapes],
        "fill_mode": "solid",
    }


def _mesh(triangles: Any) -> Any:
    """Return triangles that share no corner, so that each has its own shade."""
    points = np.array([(p.x, p.y, p.z) for p in triangles.points], np.float32).reshape(-1, 3)
    indices = np.array(triangles.indices, np.int64)
    if indices.size % 3 or (indices.size and indices.max() >= len(points)):
        raise ValueError("a mesh has corners that are not there")
    corners = points[indices].reshape(-1, 3, 3)
    return rerun_sdk().Mesh3D(
        vertex_positions=corners.reshape(-1, 3),
        vertex_normals=np.repeat(_normals(corners), 3, axis=0),
        triangle_indices=np.arange(indices.size, dtype=np.uint32).reshape(-1, 3),
        albedo_factor=_colour(triangles.color),
    )


def _normals(corners: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return unit normals (N, 3) of triangles (N, 3, 3); of flat ones, zeros."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0.0)


def _colour(color: Any) -> list[int]:
    channels = (color.r, color.g, color.b, color.a)
    return [min(255, max(0, round(255.0 * channel))) for channel in channels]
