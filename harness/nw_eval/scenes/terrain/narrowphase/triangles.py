"""Distances to triangles."""

from __future__ import annotations

import math
from typing import Any

from nw_eval.machine_code.jit import inlined, kernel

CORNERS = 9
"""Numbers of a triangle: x, y, z of its three corners, anticlockwise seen from outside."""

_SAME = 1e-9  # metres between the distances of two triangles that meet in the nearest point


@kernel
def nearest_on_triangle(t: Any, px: Any, py: Any, pz: Any) -> Any:
    """Return x, y, z of the point of a triangle that is nearest to a point.

    Ericson, Real-Time Collision Detection (2005), section 5.1.5.
    """
    ax, ay, az = t[0], t[1], t[2]
    bx, by, bz = t[3] - ax, t[4] - ay, t[5] - az
    cx, cy, cz = t[6] - ax, t[7] - ay, t[8] - az
    x, y, z = px - ax, py - ay, pz - az
    d1 = bx * x + by * y + bz * z
    d2 = cx * x + cy * y + cz * z
    if d1 <= 0.0 and d2 <= 0.0:
        return ax, ay, az
    bb = bx * bx + by * by + bz * bz
    bc = bx * cx + by * cy + bz * cz
    cc = cx * cx + cy * cy + cz * cz
    d3, d4 = d1 - bb, d2 - bc
    if d3 >= 0.0 and d4 <= d3:
        return ax + bx, ay + by, az + bz
    d5, d6 = d1 - bc, d2 - cc
    if d6 >= 0.0 and d5 <= d6:
        return ax + cx, ay + cy, az + cz
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v = d1 / (d1 - d3)
        return ax + v * bx, ay + v * by, az + v * bz
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        w = d2 / (d2 - d6)
        return ax + w * cx, ay + w * cy, az + w * cz
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 >= d3 and d5 >= d6:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return (
            ax + bx + w * (cx - bx),
            ay + by + w * (cy - by),
            az + bz + w * (cz - bz),
        )
    scale = 1.0 / (va + vb + vc)
    v, w = vb * scale, vc * scale
    return ax + v * bx + w * cx, ay + v * by + w * cy, az + v * bz + w * cz


@inlined
def triangle_normal(t: Any) -> Any:
    """Return the unit normal; 0, 0, 0 of a triangle without area."""
    ux, uy, uz = t[3] - t[0], t[4] - t[1], t[5] - t[2]
    vx, vy, vz = t[6] - t[0], t[7] - t[1], t[8] - t[2]
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    length = math.sqrt(x * x + y * y + z * z)
    scale = 1.0 / length if length > 0.0 else 0.0
    return x * scale, y * scale, z * scale


@kernel
def signed_distance(triangles: Any, px: Any, py: Any, pz: Any) -> Any:
    """Return how far a point is outside of a surface, and where.

    Which side it is on is told by the nearest triangle. Where several meet in the nearest point,
    it is the one that is seen most from its front or back: the others are seen edge on, and edge
    on both sides look alike.

    Args:
        triangles: (T, CORNERS) metres; those near the point are enough.
        px: of the point, metres.
        py: likewise.
        pz: likewise.

    Returns:
        Distance in metres, negative inside, inf without triangles; the nearest point x, y, z; and
        the outward unit direction x, y, z between them.
    """
    best, qx, qy, qz = math.inf, 0.0, 0.0, 0.0
    facing, nx, ny, nz = 0.0, 0.0, 0.0, 1.0
    for index in range(len(triangles)):
        t = triangles[index]
        # Most are told to be too far by their boxes.
        beyond = best + _SAME
        if min(t[0], t[3], t[6]) - px > beyond or px - max(t[0], t[3], t[6]) > beyond:
            continue
        if min(t[1], t[4], t[7]) - py > beyond or py - max(t[1], t[4], t[7]) > beyond:
            continue
        if min(t[2], t[5], t[8]) - pz > beyond or pz - max(t[2], t[5], t[8]) > beyond:
            continue
        x, y, z = nearest_on_triangle(t, px, py, pz)
        away = math.sqrt((px - x) ** 2 + (py - y) ** 2 + (pz - z) ** 2)
        if away > beyond:
            continue
        ux, uy, uz = triangle_normal(t)
        turned = (px - x) * ux + (py - y) * uy + (pz - z) * uz
        if away < best - _SAME or abs(turned) > abs(facing) or best == math.inf:
            facing, nx, ny, nz = turned, ux, uy, uz
        if away < best:
            best, qx, qy, qz = away, x, y, z
    side = -1.0 if facing < 0.0 else 1.0
    if best > _SAME and best < math.inf:
        nx, ny, nz = (px - qx) / best * side, (py - qy) / best * side, (pz - qz) / best * side
    return side * best, qx, qy, qz, nx, ny, nz
