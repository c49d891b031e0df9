"""A twin's mesh against its original's, where a robot goes."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from nw_scenes.rays import RayScene

WITHIN = 0.02
"""Distance up to which two surfaces are the same, metres."""
_ASIDE, _OVER, _UNDER = 0.8, 0.6, 0.6
"""The part that is compared: so far from the line of the trail, over and under its ground."""
_DENSITY = 20_000
"""Points of a square metre of a twin: 7 mm between them."""
_CELL = 0.015
"""One point of the original in each cube of this edge, metres."""
_STRIDE = 4
"""Every so many-th pixel of a photograph shows a point of the original."""


@dataclass(frozen=True, kw_only=True)
class SurfaceFigures:
    """Of a mesh beside and under the trail; metres and shares.

    Attributes:
        accuracy: median distance of its points from the original.
        precision: share of them within `WITHIN` of the original.
        completeness: share of the original that two photographs at least show, within `WITHIN` of
            the mesh.
    """

    accuracy: float
    precision: float
    completeness: float

    @property
    def f(self):
        """Harmonic mean of precision and completeness."""
        total = self.precision + self.completeness
        return 2 * self.precision * self.completeness / total if total else 0.0


def surface_figures(original, mesh, line, cameras):
    """Return how a mesh compares.

    Args:
        original: TriangleMesh, m.
        mesh: likewise of the twin, in the original's frame.
        line: (K, 3) of spawn and trail, m.
        cameras: that all photographs were really taken with.
    """
    found = _beside(_spread(mesh, line), line)
    if not len(found):
        return SurfaceFigures(accuracy=np.inf, precision=0.0, completeness=0.0)
    off = _distance(found, _near(original, line))
    gap = cKDTree(found).query(_shown(original, line, cameras))[0]
    return SurfaceFigures(
        accuracy=float(np.median(off)),
        precision=float((off < WITHIN).mean()),
        completeness=float((gap < WITHIN).mean()),
    )


def rays_of(camera, stride=1):
    """Return the unit directions (h, w, 3) in which pixels look, world, and their lengths at 1."""
    x, y = np.meshgrid(
        (np.arange(0, camera.width, stride) + 0.5 - camera.cx) / camera.fx,
        (np.arange(0, camera.height, stride) + 0.5 - camera.cy) / camera.fy,
    )
    local = np.stack([x, y, np.ones_like(x)], axis=-1)
    length = np.linalg.norm(local, axis=-1)
    return local / length[..., None] @ camera.T_world_camera[:3, :3].T, length


def _shown(original, line, cameras):
    """Return points of the original near a line that two cameras at least see."""
    rays, hits = RayScene(original), []
    for camera in cameras:
        directions, _ = rays_of(camera, _STRIDE)
        directions = directions.reshape(-1, 3)
        eye = np.broadcast_to(camera.T_world_camera[:3, 3], directions.shape)
        distance = rays.distance(eye, directions)
        there = np.isfinite(distance)
        hits.append(_beside(eye[there] + distance[there, None] * directions[there], line))
    points = np.concatenate(hits)
    _, first = np.unique(np.floor(points / _CELL).astype(np.int64), axis=0, return_index=True)
    points = points[np.sort(first)]
    return points[sum(_is_seen(points, camera, rays).astype(int) for camera in cameras) >= 2]


def _is_seen(points, camera, rays):
    T = camera.T_camera_world
    local = points @ T[:3, :3].T + T[:3, 3]
    z = np.maximum(local[:, 2], 1e-6)
    u, v = camera.fx * local[:, 0] / z + camera.cx, camera.fy * local[:, 1] / z + camera.cy
    inside = (local[:, 2] > 0.1) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    rows = np.flatnonzero(inside)
    eye = camera.T_world_camera[:3, 3]
    ways = points[rows] - eye
    far = np.linalg.norm(ways, axis=1)
    free = rays.distance(np.broadcast_to(eye, ways.shape), ways / far[:, None])
    seen = np.zeros(len(points), dtype=bool)
    seen[rows] = free > far - 0.005
    return seen


def _spread(mesh, line):
    """Return points on the faces near a line, as many on each square metre."""
    corners = _near(mesh, line)
    if not len(corners):
        return np.zeros((0, 3))
    sides = corners[:, 1:] - corners[:, :1]
    area = 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    rng, count = np.random.default_rng(0), round(_DENSITY * area.sum())
    along = (np.arange(count) + rng.random(count)) / count * area.sum()
    chosen = np.searchsorted(np.cumsum(area), along).clip(max=len(area) - 1)
    root, other = np.sqrt(rng.random(count)), rng.random(count)
    weights = np.stack([1 - root, root * (1 - other), root * other], axis=1)
    return (corners[chosen] * weights[:, :, None]).sum(axis=1)


def _near(mesh, line):
    """Return the triangles (F, 3, 3) that reach into the box about a line."""
    low = line.min(axis=0) - np.array([_ASIDE, _ASIDE, _UNDER])
    high = line.max(axis=0) + np.array([_ASIDE, _ASIDE, _OVER])
    corners = mesh.triangles
    reach = (corners.max(axis=1) >= low) & (corners.min(axis=1) <= high)
    return corners[reach.all(axis=1)]


def _beside(points, line):
    """Return the points that are near a line: beside it, and over or under its ground."""
    near = np.zeros(len(points), dtype=bool)
    for first, last in pairwise(line):
        leg = (last - first)[:2]
        share = ((points[:, :2] - first[:2]) @ leg / (leg @ leg)).clip(0.0, 1.0)
        away = np.linalg.norm(points[:, :2] - first[:2] - share[:, None] * leg, axis=1)
        ground = first[2] + share * (last - first)[2]
        height = points[:, 2] - ground
        near |= (away <= _ASIDE) & (height >= -_UNDER) & (height <= _OVER)
    return points[near]


def _distance(points, triangles):
    """Return the distance (N,) of points from the nearest of some triangles."""
    best = np.full(len(points), np.inf)
    for a, b, c in triangles:
        normal = np.cross(b - a, c - a)
        area = normal @ normal
        if area < 1e-18:
            continue
        over = (points - a) @ normal
        inside = np.ones(len(points), dtype=bool)
        apart = np.full(len(points), np.inf)
        for p, q in ((a, b), (b, c), (c, a)):
            edge, way = q - p, points - p
            inside &= np.cross(edge, way) @ normal >= 0.0
            share = (way @ edge / (edge @ edge)).clip(0.0, 1.0)
            np.minimum(apart, np.linalg.norm(way - share[:, None] * edge, axis=1), out=apart)
        np.minimum(best, np.where(inside, np.abs(over) / np.sqrt(area), apart), out=best)
    return best
