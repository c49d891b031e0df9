"""Points on the skin of a shape, close enough together that nothing of note passes between them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nw_eval.machine_code.jit import inlined, kernel

SPACING = 0.02
"""Metres between neighbours, at most."""

_AROUND = 16  # points round a circle


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
