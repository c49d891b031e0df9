"""A shape that may meet a surface: how far it reaches, and points on its skin.

The points are close enough together that nothing of note passes between them.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nw_eval.machine_code import inlined, kernel

# MuJoCo's mjtGeom.
SPHERE, CAPSULE = 2, 3
CYLINDER, BOX = 5, 6

SPACING = 0.02
"""Metres between neighbours, at most."""

_AROUND = 16  # points round a circle


@inlined
def _extent(kind: Any, size: Any, x: Any, y: Any, z: Any) -> Any:
    """Return how far a shape reaches from its centre along a unit direction of its own frame."""
    if kind == SPHERE:
        reach = size[0]
    elif kind == CAPSULE:
        reach = size[0] + size[1] * abs(z)
    elif kind == CYLINDER:
        reach = size[0] * math.sqrt(x * x + y * y) + size[1] * abs(z)
    else:
        reach = size[0] * abs(x) + size[1] * abs(y) + size[2] * abs(z)
    return reach


@inlined
def reach_of(kind: Any, size: Any, turn: Any) -> Any:
    """Return half the extents of the box around a shape, (3,), `turn` its (3, 3) rotation."""
    reach = np.empty(3)
    for axis in range(3):
        reach[axis] = _extent(kind, size, turn[axis, 0], turn[axis, 1], turn[axis, 2])
    return reach


@inlined
def radius_of(kind: Any, size: Any) -> Any:
    """Return the radius of the sphere around a shape."""
    if kind == SPHERE:
        radius = size[0]
    elif kind == CAPSULE:
        radius = size[0] + size[1]
    elif kind == CYLINDER:
        radius = math.sqrt(size[0] ** 2 + size[1] ** 2)
    else:
        radius = math.sqrt(size[0] ** 2 + size[1] ** 2 + size[2] ** 2)
    return radius


@kernel
def shape_samples(kind: Any, size: Any, turn: Any, center: Any) -> Any:
    """Return points of a shape in the surface's frame, (N, 3)."""
    if kind == BOX:
        points = box_samples(size)
    elif kind == CYLINDER:
        points = cylinder_samples(size[0], size[1], -turn[2])
    else:
        points = axis_samples(size[1])
    moved = np.empty(points.shape)
    for index in range(len(points)):
        for axis in range(3):
            moved[index, axis] = center[axis] + (
                turn[axis, 0] * points[index, 0]
                + turn[axis, 1] * points[index, 1]
                + turn[axis, 2] * points[index, 2]
            )
    return moved


@inlined
def _count(length: Any) -> Any:
    return max(math.ceil(length / SPACING - 1e-9), 1)


@kernel
def box_samples(half: Any) -> Any:
    """Return points on the faces of a box, corners and edges included, (N, 3), in its own frame.

    Args:
        half: half extents, metres.
    """
    nx, ny, nz = _count(2.0 * half[0]), _count(2.0 * half[1]), _count(2.0 * half[2])
    inner = max(nx - 1, 0) * max(ny - 1, 0) * max(nz - 1, 0)
    points = np.empty(((nx + 1) * (ny + 1) * (nz + 1) - inner, 3))
    count = 0
    for i in range(nx + 1):
        for j in range(ny + 1):
            for k in range(nz + 1):
                if 0 < i < nx and 0 < j < ny and 0 < k < nz:
                    continue
                points[count, 0] = half[0] * (2.0 * i / nx - 1.0)
                points[count, 1] = half[1] * (2.0 * j / ny - 1.0)
                points[count, 2] = half[2] * (2.0 * k / nz - 1.0)
                count += 1
    return points


@kernel
def cylinder_samples(radius: Any, half: Any, down: Any) -> Any:
    """Return points on circles round a cylinder and in the middle of its ends, (N, 3), own frame.

    Args:
        radius: metres.
        half: half length along z, metres.
        down: (3,) direction in the cylinder's frame; one point of each circle is the lowest.
    """
    rings = _count(2.0 * half)
    points = np.empty(((rings + 1) * _AROUND + 2, 3))
    first = math.atan2(down[1], down[0])
    count = 0
    for ring in range(rings + 1):
        z = half * (2.0 * ring / rings - 1.0)
        for step in range(_AROUND):
            angle = first + 2.0 * math.pi * step / _AROUND
            points[count, 0] = radius * math.cos(angle)
            points[count, 1] = radius * math.sin(angle)
            points[count, 2] = z
            count += 1
    for end in range(2):
        points[count, 0], points[count, 1], points[count, 2] = 0.0, 0.0, half * (2.0 * end - 1.0)
        count += 1
    return points


@kernel
def axis_samples(half: Any) -> Any:
    """Return points along the axis of a capsule, ends included, (N, 3), in its own frame."""
    count = 2 * _count(2.0 * half)
    points = np.zeros((count + 1, 3))
    for step in range(count + 1):
        points[step, 2] = half * (2.0 * step / count - 1.0)
    return points
