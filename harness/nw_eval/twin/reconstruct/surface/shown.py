"""What the shots show of a mesh that came without depth maps and colours of ours."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from nw_eval.scenes.mesh import FACE_KINDS, TriangleMesh
from nw_eval.scenes.rays import RayScene
from nw_eval.twin.capture import Capture
from nw_eval.twin.reconstruct.depth.maps import DepthMap
from nw_eval.twin.reconstruct.depth.view import F32, WorkingView, read_view
from nw_eval.twin.reconstruct.mesh_file import ColourMesh

_HIDDEN = 0.01
"""Share of its depth by which a vertex may lie behind the surface and be seen."""


def maps_of(
    mesh: ColourMesh, capture: Capture, folder: Path, side: int, say: Callable[[str], None]
) -> list[DepthMap]:
    """Return each shot's depth as the mesh has it; confidence is 1 where there is a surface.

    Raises:
        SceneError: a picture cannot be read.
    """
    kinds = np.full(len(mesh.faces), FACE_KINDS.index("ground"), np.uint8)
    rays = RayScene(TriangleMesh(vertices=mesh.vertices, faces=mesh.faces, kinds=kinds))
    found: list[DepthMap] = []
    for shot in capture.shots:
        view = read_view(shot, folder, side)
        depth = _depth(view, rays)
        if view.mask is not None:
            depth = np.where(view.mask, depth, np.float32(0.0))
        found.append(DepthMap(view=view, depth=depth, confidence=(depth > 0).astype(np.float32)))
        say(f"depth of {view.name}: {len(found)} of {len(capture.shots)}")
    return found


def _depth(view: WorkingView, rays: RayScene) -> F32:
    height, width = view.size
    x, y = np.meshgrid(
        (np.arange(width) + 0.5 - view.K[0, 2]) / view.K[0, 0],
        (np.arange(height) + 0.5 - view.K[1, 2]) / view.K[1, 1],
    )
    ahead = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)
    length = np.linalg.norm(ahead, axis=1)
    T = np.linalg.inv(view.T_camera_world)
    directions = ahead / length[:, None] @ T[:3, :3].T
    distance = rays.distance(np.broadcast_to(T[:3, 3], directions.shape), directions)
    depth = np.where(np.isfinite(distance), distance, 0.0) / length
    return depth.reshape(height, width).astype(np.float32)


def coloured(mesh: ColourMesh, maps: list[DepthMap]) -> ColourMesh:
    """Return the mesh with each vertex in the mean colour of the shots that see it; else grey."""
    total, count = np.zeros((len(mesh.vertices), 3)), np.zeros(len(mesh.vertices))
    for each in maps:
        view, T = each.view, each.view.T_camera_world
        local = mesh.vertices @ T[:3, :3].T + T[:3, 3]
        z = np.where(local[:, 2] > 0.0, local[:, 2], np.inf)
        u = view.K[0, 0] * local[:, 0] / z + view.K[0, 2]
        v = view.K[1, 1] * local[:, 1] / z + view.K[1, 2]
        height, width = view.size
        rows = np.flatnonzero(np.isfinite(z) & (u >= 0) & (u < width) & (v >= 0) & (v < height))
        x, y = u[rows].astype(np.int64), v[rows].astype(np.int64)
        seen = z[rows] <= each.depth[y, x] * (1.0 + _HIDDEN)
        rows, x, y = rows[seen], x[seen], y[seen]
        total[rows] += view.rgb[y, x]
        count[rows] += 1.0
    colours = np.where(count[:, None] > 0, total / np.maximum(count, 1.0)[:, None], 128.0)
    return ColourMesh(
        vertices=mesh.vertices, faces=mesh.faces, colours=np.round(colours).astype(np.uint8)
    )
