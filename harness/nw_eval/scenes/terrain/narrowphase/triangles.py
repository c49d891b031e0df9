"""Distances to triangles."""

from __future__ import annotations

import math
from typing import Any

from nw_eval.machine_code.jit import inlined, kernel

CORNERS = 9
"""Numbers of a triangle: x, y, z of its three corners, anticlockwise seen from outside."""

_SAME = 1e-9  # metres below which a point is on the surface
_MEETS = 1e-8  # metres within which triangles meet in a point


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


@inlined
def _angle(t: Any, corner: Any) -> Any:
    """Return the angle of a triangle at one of its corners, rad."""
    here, right, left = 3 * corner, 3 * ((corner + 1) % 3), 3 * ((corner + 2) % 3)
    ux, uy, uz = t[right] - t[here], t[right + 1] - t[here + 1], t[right + 2] - t[here + 2]
    vx, vy, vz = t[left] - t[here], t[left + 1] - t[here + 1], t[left + 2] - t[here + 2]
    cx, cy, cz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return math.atan2(math.sqrt(cx * cx + cy * cy + cz * cz), ux * vx + uy * vy + uz * vz)


@inlined
def is_far(t: Any, x: Any, y: Any, z: Any, reach: Any) -> Any:
    """Tell by the box around a triangle that a point is farther from it than `reach`."""
    return (
        min(t[0], t[3], t[6]) - x > reach
        or x - max(t[0], t[3], t[6]) > reach
        or min(t[1], t[4], t[7]) - y > reach
        or y - max(t[1], t[4], t[7]) > reach
        or min(t[2], t[5], t[8]) - z > reach
        or z - max(t[2], t[5], t[8]) > reach
    )


@kernel
def outward(triangles: Any, x: Any, y: Any, z: Any) -> Any:
    """Return the direction out of a surface at a point of it, x, y, z, of any length.

    The normals of all triangles that meet there, by their angles there: whoever is nearest to that
    point is outside if and only if he is on this side. Baerentzen and Aanaes, Signed distance
    computation using the angle weighted pseudonormal (2005), theorem 1.
    """
    nx, ny, nz = 0.0, 0.0, 0.0
    for index in range(len(triangles)):
        t = triangles[index]
        if is_far(t, x, y, z, _MEETS):
            continue
        qx, qy, qz = nearest_on_triangle(t, x, y, z)
        if abs(qx - x) + abs(qy - y) + abs(qz - z) > _MEETS:
            continue
        weight = math.pi
        for corner in range(3):
            c = 3 * corner
            if abs(t[c] - x) + abs(t[c + 1] - y) + abs(t[c + 2] - z) <= _MEETS:
                weight = _angle(t, corner)
        ux, uy, uz = triangle_normal(t)
        nx, ny, nz = nx + weight * ux, ny + weight * uy, nz + weight * uz
    return nx, ny, nz


@kernel
def signed_distance(triangles: Any, px: Any, py: Any, pz: Any) -> Any:
    """Return how far a point is outside of a surface, and where.

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
    for index in range(len(triangles)):
        t = triangles[index]
        if is_far(t, px, py, pz, best):
            continue
        x, y, z = nearest_on_triangle(t, px, py, pz)
        away = math.sqrt((px - x) ** 2 + (py - y) ** 2 + (pz - z) ** 2)
        if away < best:
            best, qx, qy, qz = away, x, y, z
    if best == math.inf:
        return best, qx, qy, qz, 0.0, 0.0, 1.0
    nx, ny, nz = outward(triangles, qx, qy, qz)
    side = -1.0 if (px - qx) * nx + (py - qy) * ny + (pz - qz) * nz < 0.0 else 1.0
    if best > _SAME:
        nx, ny, nz = (px - qx) / best * side, (py - qy) / best * side, (pz - qz) / best * side
    else:
        length = math.sqrt(nx * nx + ny * ny + nz * nz)
        scale = 1.0 / length if length > 0.0 else 0.0
        nx, ny, nz = nx * scale, ny * scale, nz * scale
    return side * best, qx, qy, qz, nx, ny, nz
