"""A sphere against triangles.

Outside, every place of the surface that is nearest among its neighbours, and nearer than the
radius, is a contact: one on a plane or a bump, two in a corner, also where triangles of one plane
meet. Inside, however deep, it is the one place where the way out is shortest. Nothing is thin, so
nothing is trapped and nothing tunnels.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nw_eval.machine_code.jit import kernel
from nw_eval.scenes.terrain.narrowphase.contact import CONTACT, write_contact
from nw_eval.scenes.terrain.narrowphase.triangles import (
    is_far,
    nearest_on_triangle,
    signed_distance,
)

_MOST = 6
# Contacts whose normals are nearer than 15 degrees push alike; the deeper one is kept.
_ALIKE = 0.966
_TOUCHES = 1e-8  # metres within which a point is on a triangle
_ABOVE = 1e-6  # share of a length that counts as above a plane


@kernel
def sphere_contacts(triangles: Any, x: Any, y: Any, z: Any, radius: Any, margin: Any) -> Any:
    """Return the contacts of a sphere, (N, CONTACT).

    Args:
        triangles: (T, CORNERS) all within radius and margin of the centre, and as far around it
            as it may be under the surface; metres.
        x: of the centre, metres.
        y: likewise.
        z: likewise.
        radius: metres.
        margin: distance below which there is a contact, metres.
    """
    contacts = np.empty((_MOST, CONTACT))
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
        if alike < _MOST:
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
