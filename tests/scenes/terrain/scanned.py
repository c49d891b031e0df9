"""Built-in places as a scanner would bring them home: one mesh of small, noisy triangles."""

from __future__ import annotations

import json

import numpy as np
import trimesh

from nw_scenes.mesh import FACE_KINDS, TriangleMesh, quad_mesh

AROUND = 2.5  # metres of the place to every side of spawn and trail
SPACING = 0.03  # of the vertices, metres
COARSE = 0.5  # metres between those of anything but ground and obstacles


def scan_of(scene, *, noise=0.0, seed=0):
    """Return the place's surface, sampled every 3 cm, each sample off by `noise` metres (sd)."""
    path = np.vstack([scene.trail[:, :2], [scene.spawn.position[:2]]])
    low, high = path.min(axis=0) - AROUND, path.max(axis=0) + AROUND
    width, depth = (high - low).tolist()
    ground = quad_mesh((*low, scene.ground.z), (width, 0, 0), (0, depth, 0), "ground")
    whole = scene.static_mesh
    # Ceilings are cut off scans, and of the endless ground only the part round the trail is kept.
    kept = ~np.isin(whole.kinds, [FACE_KINDS.index(kind) for kind in ("overhead", "ground")])
    kept = TriangleMesh(vertices=whole.vertices, faces=whole.faces[kept], kinds=whole.kinds[kept])
    pieces = [
        (outline, kind)
        for outline, kind in (*_outlines(ground), *_outlines(kept))
        if (outline[:, :2].max(axis=0) > low).all() and (outline[:, :2].min(axis=0) < high).all()
    ]
    soup = np.concatenate([_divided(outline, kind) for outline, kind in pieces])
    soup = soup.reshape(-1, 3)
    # Faces that share a corner share its error: the scan is as closed as the place.
    # The shift keeps round numbers, which places are made of, off the border between two roundings.
    _, first, index = np.unique(
        np.round(soup * 1e4 + 0.317), axis=0, return_index=True, return_inverse=True
    )
    points = soup[first]
    points = points + np.random.default_rng(seed).normal(0.0, noise, points.shape)
    faces = index.reshape(-1, 3).astype(np.int32)
    return TriangleMesh(vertices=points, faces=faces, kinds=np.zeros(len(faces), dtype=np.uint8))


def _outlines(mesh):
    """Return the corners of each parallelogram (4, 3), or of each lone triangle (3, 3), and kind.

    Faces of boxes and rectangles are two triangles in a row, halves of one parallelogram.
    """
    found, corners = [], mesh.triangles
    face = 0
    while face < len(corners):
        a, b, c = corners[face]
        outline, used = corners[face], 1
        if face + 1 < len(corners):
            first, second, d = corners[face + 1]
            if np.allclose([a, c, a + c], [first, second, b + d]):
                outline, used = np.stack([a, b, c, d]), 2
        found.append((outline, FACE_KINDS[mesh.kinds[face]]))
        face += used
    return found


def _divided(outline, kind):
    """Return an outline in triangles, (M, 3, 3).

    Into how many parts an edge is cut depends on its length alone, so that faces which share an
    edge go on sharing it.
    """
    spacing = SPACING if kind in ("ground", "obstacle") else COARSE
    a, right, up = outline[0], outline[1] - outline[0], outline[-1] - outline[0]
    columns, rows = (
        max(int(np.ceil(np.linalg.norm(edge) / spacing - 1e-6)), 1) for edge in (right, up)
    )
    if len(outline) == 3:
        columns = rows = max(columns, rows)
    u, v = np.meshgrid(np.arange(columns + 1) / columns, np.arange(rows + 1) / rows)
    grid = a + u[:, :, None] * right + v[:, :, None] * up
    p, q, r, s = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
    lower, upper = np.stack([p, q, s], axis=2), np.stack([q, r, s], axis=2)
    if len(outline) == 3:
        i, j = np.meshgrid(np.arange(columns), np.arange(rows))
        lower, upper = lower[i + j < columns], upper[i + j < columns - 1]
    return np.concatenate([lower.reshape(-1, 3, 3), upper.reshape(-1, 3, 3)])


def write_scan(folder, scene, **options):
    """Write the folder of a scene that is the scan of another, and return its path."""
    folder.mkdir(parents=True)
    mesh = scan_of(scene, **options)
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(folder / "scan.ply")
    spawn = scene.spawn
    document = {
        "nw-scene": 1,
        "name": f"scan/{scene.name.replace('/', '-')}",
        "task": scene.task,
        "licence": "as the place",
        "trail": scene.trail.tolist(),
        "spawn": {
            "position": list(spawn.position),
            "yaw": spawn.yaw,
            "x_jitter": spawn.x_jitter,
            "y_jitter": spawn.y_jitter,
            "yaw_jitter": spawn.yaw_jitter,
        },
        "waypoint_noise": list(scene.waypoint_noise),
        "collision": "scan.ply",
    }
    (folder / "scene.yaml").write_text(json.dumps(document))
    return folder
