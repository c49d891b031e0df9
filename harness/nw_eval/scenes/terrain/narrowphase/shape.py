"""A shape that may meet a surface: how far it reaches, and points on its skin."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nw_eval.machine_code.jit import inlined, kernel
from nw_eval.scenes.terrain.narrowphase.samples import (
    axis_samples,
    box_samples,
    cylinder_samples,
)

# MuJoCo's mjtGeom.
SPHERE, CAPSULE = 2, 3
_CYLINDER, _BOX = 5, 6


@inlined
def _extent(kind: Any, size: Any, x: Any, y: Any, z: Any) -> Any:
    """Return how far a shape reaches from its centre along a unit direction of its own frame."""
    if kind == SPHERE:
        reach = size[0]
    elif kind == CAPSULE:
        reach = size[0] + size[1] * abs(z)
    elif kind == _CYLINDER:
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
    elif kind == _CYLINDER:
        radius = math.sqrt(size[0] ** 2 + size[1] ** 2)
    else:
        radius = math.sqrt(size[0] ** 2 + size[1] ** 2 + size[2] ** 2)
    return radius


@kernel
def shape_samples(kind: Any, size: Any, turn: Any, center: Any) -> Any:
    """Return points of a shape in the surface's frame, (N, 3)."""
    if kind == _BOX:
        points = box_samples(size)
    elif kind == _CYLINDER:
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
