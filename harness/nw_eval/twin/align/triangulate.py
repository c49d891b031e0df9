"""Points from pixels in several shots, whatever some of the shots say."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_eval.splat.camera import Camera

Values = NDArray[np.float64]

_PAIRS = 150
"""Pairs of shots that are tried at most."""
_LEAST_ANGLE = math.radians(1.0)
"""Between rays, for a point that is worth something."""
_STEPS = 8


@dataclass(frozen=True, kw_only=True)
class Triangulated:
    """Points that shots agree on.

    Attributes:
        points: (K, 3) in the cameras' world.
        used: (V,) which shots agree.
        pixels: root mean square of what they are off, pixels.
    """

    points: Values
    used: NDArray[np.bool_]
    pixels: float


def triangulate(
    cameras: Sequence[Camera], pixels: Values, *, tolerance: float = 2.0
) -> Triangulated | None:
    """Return the K points that V shots see, by least squares over the shots that agree.

    Points of each pair of shots are tried; the pair that most shots agree with wins, and they are
    fitted to all of those.

    Args:
        cameras: V of them.
        pixels: (V, K, 2) of the points; the centre of the first pixel is at (0.5, 0.5).
        tolerance: how far off a shot may be at any of its points, pixels.

    Returns:
        None where no two shots agree, or their rays are parallel.
    """
    if len(cameras) < 2:
        return None
    T = np.array([camera.T_camera_world for camera in cameras])
    lens = np.array([[c.fx, c.fy, c.cx, c.cy] for c in cameras])
    centres = np.array([camera.T_world_camera[:3, 3] for camera in cameras])
    rays = _rays(T, lens, pixels)
    best: tuple[float, Values] | None = None
    for one, other in _pairs(rays):
        chosen = [one, other]
        points = _nearest(centres[chosen], rays[chosen])
        off = _worst(T, lens, pixels, points)
        cost = float((np.minimum(off, tolerance) ** 2).sum())
        if best is None or cost < best[0]:
            best = (cost, points)
    if best is None:
        return None
    points = best[1]
    used = _worst(T, lens, pixels, points) <= tolerance
    for _ in range(3):
        if np.count_nonzero(used) < 2:
            return None
        points = _refined(T[used], lens[used], pixels[used], points)
        agree = _worst(T, lens, pixels, points) <= tolerance
        if (agree == used).all():
            break
        used = agree
    if np.count_nonzero(used) < 2 or not _pairs(rays[used]):
        return None
    off = _project(T[used], lens[used], points)[0] - pixels[used]
    return Triangulated(
        points=points, used=used, pixels=float(np.sqrt((off**2).sum(axis=-1).mean()))
    )


def _rays(T: Values, lens: Values, pixels: Values) -> Values:
    """Return unit vectors (V, K, 3) in the world."""
    fx, fy, cx, cy = (lens[:, i, None] for i in range(4))
    x, y = (pixels[..., 0] - cx) / fx, (pixels[..., 1] - cy) / fy
    local = np.stack([x, y, np.ones_like(x)], axis=-1)
    rays = np.einsum("vji,vkj->vki", T[:, :3, :3], local)
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True)


def _pairs(rays: Values) -> list[tuple[int, int]]:
    """Return pairs of shots whose rays are not parallel, all or every so many of them."""
    first, second = np.triu_indices(len(rays), 1)
    cosine = (rays[first, 0] * rays[second, 0]).sum(axis=1)
    apart = np.flatnonzero(np.abs(cosine) < math.cos(_LEAST_ANGLE))
    # The wider ones place points better; with too many of them, a regular choice of all angles.
    apart = apart[np.argsort(np.abs(cosine[apart]), kind="stable")]
    if len(apart) > _PAIRS:
        apart = apart[np.linspace(0, len(apart) - 1, _PAIRS).astype(int)]
    return list(zip(first[apart].tolist(), second[apart].tolist(), strict=True))


def _nearest(centres: Values, rays: Values) -> Values:
    """Return the points (K, 3) nearest to the rays (V, K, 3) from centres (V, 3)."""
    across = np.eye(3) - rays[..., :, None] * rays[..., None, :]
    right = np.einsum("vkij,vj->ki", across, centres)
    return np.linalg.solve(across.sum(axis=0), right[..., None])[..., 0]


def _project(T: Values, lens: Values, points: Values) -> tuple[Values, Values]:
    """Return pixels (V, K, 2) and points in the cameras' axes (V, K, 3)."""
    local = np.einsum("vij,kj->vki", T[:, :3, :3], points) + T[:, None, :3, 3]
    depth = np.where(np.abs(local[..., 2]) < 1e-12, 1e-12, local[..., 2])
    x = lens[:, None, 0] * local[..., 0] / depth + lens[:, None, 2]
    y = lens[:, None, 1] * local[..., 1] / depth + lens[:, None, 3]
    return np.stack([x, y], axis=-1), local


def _worst(T: Values, lens: Values, pixels: Values, points: Values) -> Values:
    """Return how far off each shot is at its worst point, pixels; inf behind it."""
    seen, local = _project(T, lens, points)
    off = np.linalg.norm(seen - pixels, axis=-1)
    return np.where(local[..., 2] > 0, off, np.inf).max(axis=1)


def _refined(T: Values, lens: Values, pixels: Values, points: Values) -> Values:
    """Return points (K, 3) that are least off in all shots: Gauss and Newton."""
    for _ in range(_STEPS):
        seen, local = _project(T, lens, points)
        depth = local[..., 2, None]
        focal = lens[:, None, :2]
        turned = T[:, None, :3, :3]
        # d(f x / z) = f (dx - x dz / z) / z, for x and for y.
        slope = local[..., :2] / depth
        jacobian = turned[..., :2, :] - slope[..., None] * turned[..., 2:, :]
        jacobian = (focal / depth)[..., None] * jacobian
        off = pixels - seen
        normal = np.einsum("vkai,vkaj->kij", jacobian, jacobian)
        right = np.einsum("vkai,vka->ki", jacobian, off)
        points = points + np.linalg.solve(normal, right[..., None])[..., 0]
    return points
