"""Contacts of one shape with one scanned surface, as MuJoCo's table of collision functions asks.

The shape is moved into the surface's own frame, met there, and the contacts are moved back.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nw_eval.machine_code.jit import inlined, kernel
from nw_eval.scenes.terrain.narrowphase.field import field_height, field_top, field_triangles
from nw_eval.scenes.terrain.narrowphase.mesh import mesh_triangles
from nw_eval.scenes.terrain.narrowphase.samples import (
    axis_samples,
    box_samples,
    cylinder_samples,
    fewest,
)
from nw_eval.scenes.terrain.narrowphase.sphere import CONTACT, sphere_contacts
from nw_eval.scenes.terrain.narrowphase.triangles import signed_distance

# MuJoCo's mjtGeom.
_SPHERE, _CAPSULE, _CYLINDER, _BOX = 2, 3, 5, 6

# How far into the ground a way out is looked for, metres. At 4 m/s a landing foot gets 3 cm deep.
_DEEPEST = 0.08
_MOST = 6


@inlined
def _extent(kind: Any, size: Any, x: Any, y: Any, z: Any) -> Any:
    """Return how far a shape reaches from its centre along a unit direction of its own frame."""
    if kind == _SPHERE:
        reach = size[0]
    elif kind == _CAPSULE:
        reach = size[0] + size[1] * abs(z)
    elif kind == _CYLINDER:
        reach = size[0] * math.sqrt(x * x + y * y) + size[1] * abs(z)
    else:
        reach = size[0] * abs(x) + size[1] * abs(y) + size[2] * abs(z)
    return reach


@inlined
def _reach(kind: Any, size: Any, turn: Any) -> Any:
    """Return half the extents of the box around a shape, (3,), `turn` its (3, 3) rotation."""
    reach = np.empty(3)
    for axis in range(3):
        reach[axis] = _extent(kind, size, turn[axis, 0], turn[axis, 1], turn[axis, 2])
    return reach


@inlined
def _radius(kind: Any, size: Any) -> Any:
    """Return the radius of the sphere around a shape."""
    if kind == _SPHERE:
        radius = size[0]
    elif kind == _CAPSULE:
        radius = size[0] + size[1]
    elif kind == _CYLINDER:
        radius = math.sqrt(size[0] ** 2 + size[1] ** 2)
    else:
        radius = math.sqrt(size[0] ** 2 + size[1] ** 2 + size[2] ** 2)
    return radius


@kernel
def _clears(heights: Any, half: Any, origin: Any, frame: Any, position: Any, radius: Any) -> Any:
    """Tell whether a sphere is above all ground below it: most of a robot is, at most times."""
    dx, dy, dz = position[0] - origin[0], position[1] - origin[1], position[2] - origin[2]
    x = frame[0, 0] * dx + frame[1, 0] * dy + frame[2, 0] * dz
    y = frame[0, 1] * dx + frame[1, 1] * dy + frame[2, 1] * dz
    z = frame[0, 2] * dx + frame[1, 2] * dy + frame[2, 2] * dz
    return field_top(heights, half, x, y, radius, radius) < z - radius


@kernel
def _samples(kind: Any, size: Any, turn: Any, center: Any) -> Any:
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


@inlined
def _around(x: Any, y: Any, z: Any, reach: Any) -> Any:
    low, high = np.empty(3), np.empty(3)
    low[0], low[1], low[2] = x - reach, y - reach, z - reach
    high[0], high[1], high[2] = x + reach, y + reach, z + reach
    return low, high


@kernel
def _field_contacts(
    heights: Any, half: Any, kind: Any, size: Any, turn: Any, center: Any, margin: Any
) -> Any:
    """Return the contacts of a shape with a height field in the field's frame, (N, CONTACT)."""
    reach = _reach(kind, size, turn) + margin
    top = field_top(heights, half, center[0], center[1], reach[0], reach[1])
    if top < center[2] - reach[2]:
        return np.empty((0, CONTACT))
    if kind == _SPHERE:
        height = field_height(heights, half, center[0], center[1])[0]
        if height == -math.inf:
            return np.empty((0, CONTACT))
        depth = min(max(height - center[2], 0.0), _DEEPEST)
        low, high = _around(center[0], center[1], center[2], max(size[0] + margin, depth + margin))
        triangles = field_triangles(heights, half, low, high)
        return sphere_contacts(triangles, center[0], center[1], center[2], size[0], margin)
    points = _samples(kind, size, turn, center)
    radius = size[0] if kind == _CAPSULE else 0.0
    contacts = np.empty((len(points), CONTACT))
    count = 0
    for index in range(len(points)):
        x, y, z = points[index, 0], points[index, 1], points[index, 2]
        height, nx, ny, nz = field_height(heights, half, x, y)
        if height == -math.inf:
            continue
        depth = height - z
        if depth <= 0.0 and radius == 0.0:
            away, qx, qy, qz = -depth * nz, x, y, height
        else:
            low, high = _around(x, y, z, max(radius, min(depth, _DEEPEST)) + margin)
            triangles = field_triangles(heights, half, low, high)
            away, qx, qy, qz, nx, ny, nz = signed_distance(triangles, x, y, z)
            if depth > _DEEPEST and away > _DEEPEST:
                away, qx, qy, qz, nx, ny, nz = -_DEEPEST, x, y, height, 0.0, 0.0, 1.0
        if away - radius < margin:
            c = contacts[count]
            c[0], c[1], c[2], c[3], c[4], c[5], c[6] = away - radius, qx, qy, qz, nx, ny, nz
            count += 1
    return fewest(contacts[:count], _MOST)


@kernel
def _mesh_contacts(
    vertices: Any,
    faces: Any,
    boxes: Any,
    children: Any,
    leaves: Any,
    kind: Any,
    size: Any,
    turn: Any,
    center: Any,
    margin: Any,
) -> Any:
    """Return the contacts of a shape with a mesh in the mesh's frame, (N, CONTACT)."""
    reach = _reach(kind, size, turn) + _DEEPEST
    triangles = mesh_triangles(
        vertices, faces, boxes, children, leaves, center - reach, center + reach
    )
    if len(triangles) == 0:
        return np.empty((0, CONTACT))
    if kind == _SPHERE:
        return sphere_contacts(triangles, center[0], center[1], center[2], size[0], margin)
    points = _samples(kind, size, turn, center)
    radius = size[0] if kind == _CAPSULE else 0.0
    contacts = np.empty((len(points), CONTACT))
    count = 0
    for index in range(len(points)):
        away, qx, qy, qz, nx, ny, nz = signed_distance(
            triangles, points[index, 0], points[index, 1], points[index, 2]
        )
        if away > -_DEEPEST and away - radius < margin:
            c = contacts[count]
            c[0], c[1], c[2], c[3], c[4], c[5], c[6] = away - radius, qx, qy, qz, nx, ny, nz
            count += 1
    return fewest(contacts[:count], _MOST)


@kernel
def _local(position: Any, turn: Any, origin: Any, frame: Any) -> Any:
    """Return a pose (3,), (3, 3) of the world in a frame of the world."""
    center, turned = np.empty(3), np.empty((3, 3))
    for row in range(3):
        center[row] = (
            frame[0, row] * (position[0] - origin[0])
            + frame[1, row] * (position[1] - origin[1])
            + frame[2, row] * (position[2] - origin[2])
        )
        for column in range(3):
            turned[row, column] = (
                frame[0, row] * turn[0, column]
                + frame[1, row] * turn[1, column]
                + frame[2, row] * turn[2, column]
            )
    return center, turned


@kernel
def _record(contacts: Any, origin: Any, frame: Any, records: Any) -> Any:
    """Write contacts as MuJoCo's records, in the world; return how many."""
    for index in range(len(contacts)):
        c, record = contacts[index], records[index]
        record[0] = c[0]
        for row in range(3):
            x, y, z = frame[row, 0], frame[row, 1], frame[row, 2]
            normal = x * c[4] + y * c[5] + z * c[6]
            # Midway between the two surfaces.
            place = origin[row] + x * c[1] + y * c[2] + z * c[3]
            record[1 + row] = place + 0.5 * c[0] * normal
            record[4 + row] = normal
            record[7 + row] = 0.0
    return len(contacts)


@kernel
def collide_with_field(
    heights: Any,
    half: Any,
    origin: Any,
    frame: Any,
    kind: Any,
    size: Any,
    position: Any,
    turn: Any,
    margin: Any,
    records: Any,
) -> Any:
    """Write the contacts of a shape with a height field; return how many.

    Args:
        heights: (R, C) float32 shares of `half[2]`.
        half: half extents along x and y, and the height of a share of 1, metres.
        origin: (3,) the field's place in the world, metres.
        frame: (3, 3) its rotation to the world.
        kind: the shape, by MuJoCo's mjtGeom.
        size: (3,) as in MJCF, metres.
        position: (3,) of the shape in the world, metres.
        turn: (3, 3) its rotation to the world.
        margin: distance below which there is a contact, metres.
        records: (50, 10) out: mjPreContact, normals from the ground to the shape.
    """
    if _clears(heights, half, origin, frame, position, _radius(kind, size) + margin):
        return 0
    center, turned = _local(position, turn, origin, frame)
    contacts = _field_contacts(heights, half, kind, size, turned, center, margin)
    return _record(contacts, origin, frame, records)


@kernel
def collide_with_mesh(
    vertices: Any,
    faces: Any,
    boxes: Any,
    children: Any,
    leaves: Any,
    origin: Any,
    frame: Any,
    kind: Any,
    size: Any,
    position: Any,
    turn: Any,
    margin: Any,
    records: Any,
) -> Any:
    """Write the contacts of a shape with a mesh; return how many. Arguments as the others'."""
    center, turned = _local(position, turn, origin, frame)
    contacts = _mesh_contacts(
        vertices, faces, boxes, children, leaves, kind, size, turned, center, margin
    )
    return _record(contacts, origin, frame, records)
