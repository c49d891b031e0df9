"""Distances to triangles, and the contacts of a sphere with them.

A contact is a row of numbers: written, thinned out, and handed to MuJoCo. Outside, every place of
the surface that is nearest among its neighbours, and nearer than the radius, is a contact of a
sphere: one on a plane or a bump, two in a corner, also where triangles of one plane meet. Inside,
however deep, it is the one place where the way out is shortest. Nothing is thin, so nothing is
trapped and nothing tunnels.

A shape that may meet them has points on its skin, close enough together that nothing of note passes
between them.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nw_base.machine_code import inlined, kernel

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


CORNERS = 9
"""Numbers of a triangle: x, y, z of its three corners, anticlockwise seen from outside."""

_SAME = 1e-9  # metres below which a point is on the surface
_MEETS = 1e-8  # metres within which triangles meet in a point

CONTACT = 7
"""Numbers of a contact: distance (negative: how deep), x, y, z of the surface, outward normal."""

_MOST_OF_SPHERE = 6
# Contacts whose normals are nearer than 15 degrees push alike; the deeper one is kept.
_ALIKE = 0.966
_TOUCHES = 1e-8  # metres within which a point is on a triangle
_ABOVE = 1e-6  # share of a length that counts as above a plane


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
    apex, right, left = 3 * corner, 3 * ((corner + 1) % 3), 3 * ((corner + 2) % 3)
    ux, uy, uz = t[right] - t[apex], t[right + 1] - t[apex + 1], t[right + 2] - t[apex + 2]
    vx, vy, vz = t[left] - t[apex], t[left + 1] - t[apex + 1], t[left + 2] - t[apex + 2]
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
        px: x of the point, metres.
        py: y of the point, metres.
        pz: z of the point, metres.

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


@kernel
def write_contact(
    contact: Any, depth: Any, x: Any, y: Any, z: Any, nx: Any, ny: Any, nz: Any
) -> None:
    """Write one contact, (CONTACT,)."""
    contact[0] = depth
    contact[1], contact[2], contact[3] = x, y, z
    contact[4], contact[5], contact[6] = nx, ny, nz


@kernel
def fewest(contacts: Any, most: Any) -> Any:
    """Keep the contacts that carry: the deepest, then always the one farthest from those kept.

    Args:
        contacts: (N, CONTACT) of one shape.
        most: how many to keep.
    """
    if len(contacts) <= most:
        return contacts
    kept = np.empty((most, contacts.shape[1]))
    distance = np.full(len(contacts), math.inf)
    chosen = 0
    for index in range(len(contacts)):
        if contacts[index, 0] < contacts[chosen, 0]:
            chosen = index
    for number in range(most):
        kept[number] = contacts[chosen]
        x, y, z = contacts[chosen, 1], contacts[chosen, 2], contacts[chosen, 3]
        farthest = 0
        for index in range(len(contacts)):
            dx = contacts[index, 1] - x
            dy = contacts[index, 2] - y
            dz = contacts[index, 3] - z
            distance[index] = min(distance[index], dx * dx + dy * dy + dz * dz)
            if distance[index] > distance[farthest]:
                farthest = index
        chosen = farthest
    return kept


@kernel
def write_records(contacts: Any, origin: Any, frame: Any, records: Any) -> Any:
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
def sphere_contacts(triangles: Any, x: Any, y: Any, z: Any, radius: Any, margin: Any) -> Any:
    """Return the contacts of a sphere, (N, CONTACT).

    Args:
        triangles: (T, CORNERS) all within radius and margin of the centre, and as far around it
            as it may be under the surface; metres.
        x: of the centre, metres.
        y: of the centre, metres.
        z: of the centre, metres.
        radius: metres.
        margin: distance below which there is a contact, metres.
    """
    contacts = np.empty((_MOST_OF_SPHERE, CONTACT))
    away, qx, qy, qz, nx, ny, nz = signed_distance(triangles, x, y, z)
    if not away < radius + margin:
        return contacts[:0]
    write_contact(contacts[0], away - radius, qx, qy, qz, nx, ny, nz)
    count = 1
    if away <= _TOUCHES:
        return contacts[:1]
    for index in range(len(triangles)):
        if is_far(triangles[index], x, y, z, radius + margin):
            continue
        qx, qy, qz = nearest_on_triangle(triangles[index], x, y, z)
        away = math.sqrt((x - qx) ** 2 + (y - qy) ** 2 + (z - qz) ** 2)
        if away >= radius + margin:
            continue
        nx, ny, nz = (x - qx) / away, (y - qy) / away, (z - qz) / away
        alike = _alike(contacts[:count], nx, ny, nz)
        if alike < count and away - radius >= contacts[alike, 0]:
            continue
        if not _nearest_around(triangles, index, qx, qy, qz, nx, ny, nz):
            continue
        if alike < _MOST_OF_SPHERE:
            write_contact(contacts[alike], away - radius, qx, qy, qz, nx, ny, nz)
            count = max(count, alike + 1)
    return contacts[:count]


@kernel
def _alike(contacts: Any, nx: Any, ny: Any, nz: Any) -> Any:
    """Return the number of the first contact that pushes alike, or how many there are."""
    for index in range(len(contacts)):
        c = contacts[index]
        if c[4] * nx + c[5] * ny + c[6] * nz > _ALIKE:
            return index
    return len(contacts)


@kernel
def _nearest_around(
    triangles: Any, index: Any, x: Any, y: Any, z: Any, nx: Any, ny: Any, nz: Any
) -> Any:
    """Tell whether no triangle that meets a point goes on from there towards the normal's side."""
    for other in range(len(triangles)):
        t = triangles[other]
        if is_far(t, x, y, z, _TOUCHES):
            continue
        if other != index:
            ox, oy, oz = nearest_on_triangle(t, x, y, z)
            if abs(ox - x) + abs(oy - y) + abs(oz - z) > _TOUCHES:
                continue
        for corner in range(3):
            vx, vy, vz = t[3 * corner] - x, t[3 * corner + 1] - y, t[3 * corner + 2] - z
            length = math.sqrt(vx * vx + vy * vy + vz * vz)
            if vx * nx + vy * ny + vz * nz > _ABOVE * length + _TOUCHES:
                return False
    return True
