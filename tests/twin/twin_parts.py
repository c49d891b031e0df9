"""Captures, meshes and Gaussians in few words, for tests that need some to begin with."""

import numpy as np

from nw_scenes.mesh import TriangleMesh
from nw_splat.gaussians import Gaussians
from nw_twin.capture import Capture, PlacedShot


def placed(name, camera, seen=(), **more):
    """Return a shot whose picture has its name, and that sees these points."""
    shot = {"file": name, "seen": np.array(seen, np.int32)} | more
    return PlacedShot(name=name, camera=camera, **shot)


def captured(shots, points=None, **facts):
    """Return a capture with grey points (N, 3), or with none."""
    points = np.zeros((0, 3)) if points is None else points
    return Capture(
        shots=tuple(shots),
        points=points,
        colours=np.full(points.shape, 128, np.uint8),
        errors=np.full(len(points), 0.5, np.float32),
        **facts,
    )


def grid(corner, u, v, cells):
    """Return vertices (N, 3) and faces (F, 3) of a parallelogram of `cells` along u and along v.

    Faces look along u x v.
    """
    corner, u, v = (np.array(each, dtype=np.float64) for each in (corner, u, v))
    a, b = np.meshgrid(*(np.linspace(0, 1, count + 1) for count in cells), indexing="ij")
    first = (np.arange(cells[0])[:, None] * (cells[1] + 1) + np.arange(cells[1])).ravel()
    p, q, r, s = first, first + cells[1] + 1, first + cells[1] + 2, first + 1
    faces = np.concatenate([np.stack([p, q, r], 1), np.stack([p, r, s], 1)])
    return corner + a.reshape(-1, 1) * u + b.reshape(-1, 1) * v, faces.astype(np.int32)


def joined(*parts):
    """Return the vertices and the faces of several meshes as those of one."""
    firsts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    faces = [faces + first for (_, faces), first in zip(parts, firsts, strict=False)]
    return np.concatenate([vertices for vertices, _ in parts]), np.concatenate(faces)


def terrain(vertices, faces):
    """Return a mesh whose faces are all ground."""
    faces = np.asarray(faces, dtype=np.int32)
    kinds = np.zeros(len(faces), np.uint8)
    return TriangleMesh(vertices=np.asarray(vertices, float), faces=faces, kinds=kinds)


def blobs(points, *, size=0.02, opacity_logit=3.0):
    """Return round grey Gaussians at points (N, 3), metres."""
    count = len(points)
    return Gaussians(
        means=np.asarray(points, np.float32),
        log_scales=np.full((count, 3), np.log(size)),
        quats=np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
        opacity_logits=np.full(count, opacity_logit),
        sh=np.zeros((count, 1, 3)),
    )
