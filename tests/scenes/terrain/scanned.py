"""Built-in places as a scanner would bring them home: one mesh of small, noisy triangles."""

from __future__ import annotations

import json

import numpy as np
import trimesh

from nw_eval.scenes.mesh import FACE_KINDS, TriangleMesh, quad_mesh

AROUND = 2.5  # metres of the place to every side of spawn and trail
SPACING = 0.03  # of the vertices, metres
COARSE = 40  # pieces that the edge of anything but ground and obstacles is divided into, at most


def scan_of(scene, *, noise=0.0, seed=0):
    """Return the place's surface, sampled every 3 cm, each sample off by `noise` metres (sd)."""
    path = np.vstack([scene.trail[:, :2], [scene.spawn.position[:2]]])
    low, high = path.min(axis=0) - AROUND, path.max(axis=0) + AROUND
    width, depth = (high - low).tolist()
    ground = quad_mesh((*low, scene.ground.z), (width, 0, 0), (0, depth, 0), "ground")
    whole = scene.static_mesh
    corners = whole.triangles
    near = (corners[:, :, :2].max(axis=1) > low).all(axis=1)
    near &= (corners[:, :, :2].min(axis=1) < high).all(axis=1)
    # Ceilings are cut off scans, and of the endless ground only the part round the trail is kept.
    kept = near & (whole.kinds != FACE_KINDS.index("overhead"))
    kept &= whole.kinds != FACE_KINDS.index("ground")
    rest = TriangleMesh(vertices=whole.vertices, faces=whole.faces[kept], kinds=whole.kinds[kept])
    pieces = [
        _divided(corner, kind)
        for mesh in (ground, rest)
        for corner, kind in zip(mesh.triangles, mesh.kinds, strict=True)
    ]
    soup = np.concatenate(pieces).reshape(-1, 3)
    # Faces that share a corner share its error: the scan is as closed as the place.
    points, index = np.unique(np.round(soup, 5), axis=0, return_inverse=True)
    points = points + np.random.default_rng(seed).normal(0.0, noise, points.shape)
    faces = index.reshape(-1, 3).astype(np.int32)
    return TriangleMesh(vertices=points, faces=faces, kinds=np.zeros(len(faces), dtype=np.uint8))


def _divided(corners, kind):
    """Return a triangle (3, 3) in like pieces, (N, 3, 3)."""
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
    count = max(int(np.ceil(edges.max() / (SPACING * np.sqrt(2)))), 1)
    if FACE_KINDS[kind] not in ("ground", "obstacle"):
        count = min(count, COARSE)
    i, j = np.meshgrid(np.arange(count), np.arange(count), indexing="ij")
    i, j = i[i + j < count], j[i + j < count]
    whole = np.stack([np.stack([i, j]), np.stack([i + 1, j]), np.stack([i, j + 1])])
    inner = i + j < count - 1
    i, j = i[inner], j[inner]
    turned = np.stack([np.stack([i + 1, j]), np.stack([i + 1, j + 1]), np.stack([i, j + 1])])
    shares = np.concatenate([whole, turned], axis=2).transpose(2, 0, 1) / count  # (N, 3, 2)
    along = np.stack([corners[1] - corners[0], corners[2] - corners[0]])
    return corners[0] + shares @ along


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
