"""Contacts of one shape with one scanned surface, as MuJoCo's table of collision functions asks.

The shape is moved into the surface's own frame, met there, and the contacts are moved back. A
height field's pairs are given to one function, of MuJoCo's type mjfCollision.

MuJoCo keeps a ground as heights, whose coordinates are those of its own frame, metres: x along the
columns, y along the rows, the origin in the middle. A cell is two triangles, divided from its lower
left to its upper right sample, as `nw_scenes.scene.HeightField` says. Triangles of a mesh are
found by the tree of boxes that MuJoCo has made.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numba import types

from nw_base.machine_code import c_function, inlined, kernel
from nw_scenes.narrowphase import CARRIER_BASE
from nw_scenes.narrowphase.triangles import (
    CAPSULE,
    CONTACT,
    CORNERS,
    SPHERE,
    fewest,
    radius_of,
    reach_of,
    shape_samples,
    signed_distance,
    sphere_contacts,
    write_contact,
    write_records,
)


@kernel
def field_height(heights: Any, half: Any, x: Any, y: Any) -> Any:
    """Return the height at a point and the unit normal there; -inf and upwards beyond the rim.

    Args:
        heights: (R, C) float32 shares of `half[2]`.
        half: half extents along x and y, and the height of a share of 1, metres.
        x: metres.
        y: metres.
    """
    rows, columns = heights.shape
    dx, dy = 2.0 * half[0] / (columns - 1), 2.0 * half[1] / (rows - 1)
    u, v = (x + half[0]) / dx, (y + half[1]) / dy
    if not (u >= 0.0 and u <= columns - 1 and v >= 0.0 and v <= rows - 1):
        return -math.inf, 0.0, 0.0, 1.0
    c, r = min(int(u), columns - 2), min(int(v), rows - 2)
    a, b = u - c, v - r
    near, far = half[2] * heights[r, c], half[2] * heights[r + 1, c + 1]
    if a >= b:
        right = half[2] * heights[r, c + 1]
        along, across = right - near, far - right
    else:
        up = half[2] * heights[r + 1, c]
        along, across = far - up, up - near
    slope_x, slope_y = along / dx, across / dy
    scale = 1.0 / math.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
    return near + a * along + b * across, -slope_x * scale, -slope_y * scale, scale


@inlined
def _cells(low: Any, high: Any, half: Any, count: Any) -> Any:
    """Return the first cell that an interval of one axis touches, and the one after the last."""
    scale = (count - 1) / (2.0 * half)
    first = min(max(math.floor((low + half) * scale), 0.0), count - 1.0)
    last = min(max(math.floor((high + half) * scale), -1.0), count - 2.0)
    return int(first), int(last) + 1


@kernel
def field_top(heights: Any, half: Any, x: Any, y: Any, reach_x: Any, reach_y: Any) -> Any:
    """Return the largest height over a rectangle, metres; -inf beyond the rim.

    Args:
        heights: (R, C) shares.
        half: as `field_height`.
        x: of the rectangle's middle, metres.
        y: of the rectangle's middle, metres.
        reach_x: half its width, metres.
        reach_y: half its depth.
    """
    rows, columns = heights.shape
    c0, c1 = _cells(x - reach_x, x + reach_x, half[0], columns)
    r0, r1 = _cells(y - reach_y, y + reach_y, half[1], rows)
    top = -math.inf
    if c1 > c0 and r1 > r0:
        for r in range(r0, r1 + 1):
            for c in range(c0, c1 + 1):
                top = max(top, heights[r, c])
    return top * half[2]


@kernel
def field_triangles(heights: Any, half: Any, low: Any, high: Any) -> Any:
    """Return the triangles of the cells that touch a box, (T, CORNERS) float64.

    Args:
        heights: (R, C) shares.
        half: as `field_height`.
        low: x, y and z of the box's lower corner.
        high: of its upper corner.
    """
    rows, columns = heights.shape
    dx, dy = 2.0 * half[0] / (columns - 1), 2.0 * half[1] / (rows - 1)
    c0, c1 = _cells(low[0], high[0], half[0], columns)
    r0, r1 = _cells(low[1], high[1], half[1], rows)
    triangles = np.empty((2 * max(c1 - c0, 0) * max(r1 - r0, 0), CORNERS))
    count = 0
    for r in range(r0, r1):
        y = r * dy - half[1]
        for c in range(c0, c1):
            x = c * dx - half[0]
            near, right = half[2] * heights[r, c], half[2] * heights[r, c + 1]
            up, far = half[2] * heights[r + 1, c], half[2] * heights[r + 1, c + 1]
            if max(near, right, up, far) < low[2]:
                continue
            if min(near, right, up, far) > high[2]:
                continue
            for half_cell in range(2):
                t = triangles[count]
                t[0], t[1], t[2] = x, y, near
                if half_cell == 0:
                    t[3], t[4], t[5] = x + dx, y, right
                    t[6], t[7], t[8] = x + dx, y + dy, far
                else:
                    t[3], t[4], t[5] = x + dx, y + dy, far
                    t[6], t[7], t[8] = x, y + dy, up
                count += 1
    return triangles[:count]


@inlined
def _apart(box: Any, low: Any, high: Any) -> Any:
    apart = False
    for axis in range(3):
        if box[axis] - box[3 + axis] > high[axis] or box[axis] + box[3 + axis] < low[axis]:
            apart = True
    return apart


@kernel
def mesh_triangles(
    vertices: Any, faces: Any, boxes: Any, children: Any, leaves: Any, low: Any, high: Any
) -> Any:
    """Return the triangles whose boxes touch a box, (T, CORNERS) float64, in the mesh's frame.

    Args:
        vertices: (V, 3) float32, metres.
        faces: (F, 3) int32.
        boxes: (N, 6) centre and half extents of the tree's nodes, metres.
        children: (N, 2) int32, numbers of nodes, -1 where there is none.
        leaves: (N,) int32, number of the face of a leaf, -1 for other nodes.
        low: (3,) lower corner, metres.
        high: (3,) upper corner.
    """
    waiting = np.empty(64, dtype=np.int64)
    triangles = np.empty((64, CORNERS))
    count = 0
    number = 1
    waiting[0] = 0
    while number > 0:
        number -= 1
        node = waiting[number]
        if _apart(boxes[node], low, high):
            continue
        if leaves[node] >= 0:
            if count == len(triangles):
                more = np.empty((2 * count, CORNERS))
                more[:count] = triangles
                triangles = more
            for corner in range(3):
                vertex = faces[leaves[node], corner]
                for axis in range(3):
                    triangles[count, 3 * corner + axis] = vertices[vertex, axis]
            count += 1
            continue
        if number + 2 > len(waiting):
            longer = np.empty(2 * len(waiting), dtype=np.int64)
            longer[:number] = waiting[:number]
            waiting = longer
        for side in range(2):
            if children[node, side] >= 0:
                waiting[number] = children[node, side]
                number += 1
    return triangles[:count]


# How far into the ground a way out is looked for, metres. At 4 m/s a landing foot gets 3 cm deep.
_DEEPEST = 0.08
_MOST = 6

# Its declared types know no array whose length is read from another.
carray: Any = numba.carray  # pyright: ignore[reportPrivateImportUsage]

MESH = 7  # mjGEOM_MESH
MOST_RECORDS = 50  # mjMAXCONPAIR
RECORD = 10  # numbers of an mjPreContact


def collision_function(model_at: dict[str, int], data_at: dict[str, int]) -> Any:
    """Compile the function; see `c_function`.

    Args:
        model_at: numbers of the words of mjModel that point at its arrays.
        data_at: as above, of mjData.
    """
    word = types.CPointer(types.voidptr)
    numbers = types.CPointer(types.float64)
    geom_type, geom_dataid, geom_size = (
        model_at["geom_type"],
        model_at["geom_dataid"],
        model_at["geom_size"],
    )
    hfield_size, hfield_nrow, hfield_ncol, hfield_adr, hfield_data = (
        model_at[f"hfield_{name}"] for name in ("size", "nrow", "ncol", "adr", "data")
    )
    mesh_vertadr, mesh_vert, mesh_faceadr, mesh_face, mesh_bvhadr = (
        model_at[f"mesh_{name}"] for name in ("vertadr", "vert", "faceadr", "face", "bvhadr")
    )
    bvh_aabb, bvh_child, bvh_nodeid = (
        model_at["bvh_aabb"],
        model_at["bvh_child"],
        model_at["bvh_nodeid"],
    )
    geom_xpos, geom_xmat = data_at["geom_xpos"], data_at["geom_xmat"]

    def collide(m: Any, d: Any, con: Any, g1: Any, g2: Any, margin: Any) -> Any:
        geoms = max(g1, g2) + 2
        types_of = carray(m[geom_type], (geoms,), np.int32)
        data_of = carray(m[geom_dataid], (geoms,), np.int32)
        sizes = carray(m[geom_size], (geoms, 3), np.float64)
        places = carray(d[geom_xpos], (geoms, 3), np.float64)
        turns = carray(d[geom_xmat], (geoms, 3, 3), np.float64)
        records = carray(con, (MOST_RECORDS, RECORD), np.float64)
        field = data_of[g1]
        rows = carray(m[hfield_nrow], (field + 1,), np.int32)[field]
        columns = carray(m[hfield_ncol], (field + 1,), np.int32)[field]
        half = carray(m[hfield_size], (field + 1, 4), np.float64)[field]
        # Every field of this process comes here: one of another model may be small, too.
        if half[3] != CARRIER_BASE or types_of[g1 + 1] != MESH:
            start = carray(m[hfield_adr], (field + 1,), np.int32)[field]
            shares = carray(m[hfield_data], (start + rows * columns,), np.float32)[start:]
            return collide_with_field(
                shares.reshape((rows, columns)),
                half,
                places[g1],
                turns[g1],
                types_of[g2],
                sizes[g2],
                places[g2],
                turns[g2],
                margin,
                records,
            )
        mesh = data_of[g1 + 1]
        vertices = carray(m[mesh_vertadr], (mesh + 1,), np.int32)[mesh]
        faces = carray(m[mesh_faceadr], (mesh + 1,), np.int32)[mesh]
        tree = carray(m[mesh_bvhadr], (mesh + 1,), np.int32)[mesh]
        # Their lengths are not looked up: only what the tree names is read.
        far = 1 << 28
        return collide_with_mesh(
            carray(m[mesh_vert], (far, 3), np.float32)[vertices:],
            carray(m[mesh_face], (far, 3), np.int32)[faces:],
            carray(m[bvh_aabb], (far, 6), np.float64)[tree:],
            carray(m[bvh_child], (far, 2), np.int32)[tree:],
            carray(m[bvh_nodeid], (far,), np.int32)[tree:],
            places[g1 + 1],
            turns[g1 + 1],
            types_of[g2],
            sizes[g2],
            places[g2],
            turns[g2],
            margin,
            records,
        )

    arguments = (word, word, numbers, types.int32, types.int32, types.float64)
    return c_function(collide, arguments, types.int32)


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
    if _clears(heights, half, origin, frame, position, radius_of(kind, size) + margin):
        return 0
    center, turned = _local(position, turn, origin, frame)
    contacts = _field_contacts(heights, half, kind, size, turned, center, margin)
    return write_records(contacts, origin, frame, records)


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
    return write_records(contacts, origin, frame, records)


@kernel
def _clears(heights: Any, half: Any, origin: Any, frame: Any, position: Any, radius: Any) -> Any:
    """Tell whether a sphere is above all ground below it: most of a robot is, at most times."""
    dx, dy, dz = position[0] - origin[0], position[1] - origin[1], position[2] - origin[2]
    x = frame[0, 0] * dx + frame[1, 0] * dy + frame[2, 0] * dz
    y = frame[0, 1] * dx + frame[1, 1] * dy + frame[2, 1] * dz
    z = frame[0, 2] * dx + frame[1, 2] * dy + frame[2, 2] * dz
    return field_top(heights, half, x, y, radius, radius) < z - radius


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
    reach = reach_of(kind, size, turn) + margin
    top = field_top(heights, half, center[0], center[1], reach[0], reach[1])
    if top < center[2] - reach[2]:
        return np.empty((0, CONTACT))
    if kind == SPHERE:
        height = field_height(heights, half, center[0], center[1])[0]
        if height == -math.inf:
            return np.empty((0, CONTACT))
        depth = min(max(height - center[2], 0.0), _DEEPEST)
        low, high = _around(center[0], center[1], center[2], max(size[0] + margin, depth + margin))
        triangles = field_triangles(heights, half, low, high)
        return sphere_contacts(triangles, center[0], center[1], center[2], size[0], margin)
    points = shape_samples(kind, size, turn, center)
    radius = size[0] if kind == CAPSULE else 0.0
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
            write_contact(contacts[count], away - radius, qx, qy, qz, nx, ny, nz)
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
    reach = reach_of(kind, size, turn) + _DEEPEST
    triangles = mesh_triangles(
        vertices, faces, boxes, children, leaves, center - reach, center + reach
    )
    if len(triangles) == 0:
        return np.empty((0, CONTACT))
    if kind == SPHERE:
        return sphere_contacts(triangles, center[0], center[1], center[2], size[0], margin)
    points = shape_samples(kind, size, turn, center)
    radius = size[0] if kind == CAPSULE else 0.0
    contacts = np.empty((len(points), CONTACT))
    count = 0
    for index in range(len(points)):
        away, qx, qy, qz, nx, ny, nz = signed_distance(
            triangles, points[index, 0], points[index, 1], points[index, 2]
        )
        if away > -_DEEPEST and away - radius < margin:
            write_contact(contacts[count], away - radius, qx, qy, qz, nx, ny, nz)
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
